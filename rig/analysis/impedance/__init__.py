"""Impedance of a rig and of the walls that it renders: estimates from whole periods, verdicts, closed forms.

No simulation and no loop: arrays in, numbers out. The excitation is `rig.control.excitation.Multisine`.

* `signals`: one realisation as it was recorded
* `estimate`: `periodic`, the ratio of lines with the excitation as instrument, and what an `Impedance` is
* `welch`: the same from averaged spectra, with tfestimate's settings
* `fitting`: mass, damping and stiffness of an impedance
* `verdict`: passive or not, and how faithful
* `ideal`: what a linear rig with a sampled wall must show
"""
