"""The wire protocol of a haptic rig: frames, messages, parameters, states.

The package uses no port, clock or thread. `Connection` turns bytes into events; the same class is used by host and
device. `PROTOCOL.md` in this folder documents every byte. `rig.devices`, `rig.loop`, `rig.firmware` and the simulation
build on this package; it must not import them.
"""
