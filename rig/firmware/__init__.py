"""The firmware of a board for one rig: built, inspected, flashed and tested.

* `boards`: what a board is, read from the ``board.toml`` beside its port;
* `board_config`: the rig as a C constant, and the record that identifies an image (`record`);
* `toolchain`, `elf`, `uf2`, `build`: from sources to files that can be flashed;
* `flash`: onto a board whose boot ROM shows itself as a drive;
* `info`: what an image or a connected device is, and whether this package can run it;
* `port_check`: whether a port does its duties, tried on its board by a program in the core's place;
* `selftest`: a device checks itself over its own link, without moving; `stream`: the samples that its law sends.
"""
