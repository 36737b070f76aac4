"""Links from a host to a simulated board: in memory, by pseudo-terminal, by socket, over emulated USB."""
