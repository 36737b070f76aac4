"""Drives that people already own, as devices: the firmware on this computer, with a drive as its encoder and amplifier.

A bridge is a port of the firmware (`firmware_protocol/firmware/bridge`), so that loop, gate, safety and recordings are
those of any device. Before it runs, the drive is asked who it is and how it is set up (`moteus`, `odrive`): nothing
that could move the handle otherwise than the experiment says is let through.

* `library`: the C code, compiled on first use
* `bus`: an adapter's serial port, or a CAN interface of Linux
* `moteus`, `odrive`: a drive, and what must be true of it; `fitting`: what any of them must agree about with a rig
* `address`: what a URL says of a drive
* `faults`: what a drive may report
* `serve`: the process that runs a bridge; `link` starts one for a run
"""
