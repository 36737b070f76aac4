"""Run sweeps on the machines of a Dask cluster."""
