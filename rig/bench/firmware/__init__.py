"""The firmware of a board for one rig: built, looked at, flashed, and asked to test itself.

* `boards`: what a board is, read from the ``board.toml`` beside its port;
* `board_config`: the rig as a C constant, and the record by which an image says what it is (`record`);
* `toolchain`, `elf`, `uf2`, `build`: from sources to files that can be flashed;
* `flash`: onto a board whose boot ROM shows itself as a drive;
* `info`: what an image or a connected device says of itself, and whether this package can speak to it;
* `selftest`, of `check`s: a device checks itself over its own link, without moving; `stream`: what its law has told.
"""
