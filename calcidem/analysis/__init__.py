"""Evaluation of the velocities of a campaign, from distribution to prediction.

All functions take records, plain arrays or xarray and return frozen records or xarray. None reads a database or
simulates, so the same code serves a campaign, a published table and other data. Import from the modules:

- `velocity`: errors of velocities, modulus and wavelengths, advice, phase velocity over frequency;
- `distribution`: counts of cells, moments, normality and intervals of Vs at each content; `intervals`, seeds needed;
- `packing_graph`: contacts of a stored packing, preferential path, C_d and C_d,n, features of path and network;
- `campaign_analysis`: all products of a campaign;
- `correlation`: Pearson and Spearman, over all contents and within one; the best ratio of the contact weights;
- `fits`: Vs = a C^b + c with intervals, leave-one-seed-out error; Vs of samples that were not simulated;
- `measured`: comparison with laboratory velocities, and with the tables of the reproduced study.
"""
