"""The simulated rig: mechanics, sensors, a device that speaks the wire protocol, simulated drives, and their links.

`rig.devices` loads it for ``sim://``. Only tests may import it directly, and it must not import `rig.experiments`.
"""
