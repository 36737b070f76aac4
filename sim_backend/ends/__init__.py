"""How a host reaches a simulated board: in memory, by pseudo-terminal, by socket, over emulated USB."""
