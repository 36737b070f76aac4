"""Use a commercial motor drive (moteus, ODrive) as a device: this computer runs the firmware in place of a board.

A *bridge* is a port of the firmware (`firmware_protocol/firmware/bridge`) to this computer. The drive is its encoder
and amplifier, so that control loop, safety checks and recordings are the same as with any device. Before a bridge runs,
it reads the drive's identity and settings (`moteus`, `odrive`), and refuses settings with which the drive would not
move as commanded.

* `library`: the C code, compiled on first use
* `bus`: an adapter's serial port, or a CAN interface of Linux
* `moteus`, `odrive`: one kind of drive, and its requirements; `fitting`: requirements of any drive for a rig
* `address`: the address of a drive in a URL
* `faults`: the faults that a bridge reports
* `serve`: the process that runs a bridge; `link` starts one for a run
"""
