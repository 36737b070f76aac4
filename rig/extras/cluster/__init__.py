"""Run sweeps (many independent simulations) on the machines of a Dask cluster."""
