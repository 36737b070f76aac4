"""Build, inspect, flash and test the firmware of a board for one rig.

* `boards`: description of a board, read from the ``board.toml`` in the directory of its C files;
* `board_config`: the rig as a C constant, and the record that identifies an image (`record`);
* `toolchain`, `elf`, `uf2`, `build`: compile the sources to files that can be flashed;
* `flash`: copy an image to a board whose boot ROM appears as a USB drive;
* `info`: identify an image or a connected device, and check whether this package can run it;
* `port_check`: test on a board whether its board-specific code (the port) fulfils its duties;
* `selftest`: test a device over its link without moving it; `stream`: check the samples that its law sends.
"""
