"""Evaluation of the velocities of a campaign, from distribution to prediction.

All functions take records, plain arrays or xarray and return frozen records or xarray. None reads a database or
simulates, so the same code serves a campaign, a published table and other data. Import from the modules:

- `distribution`: moments, normality, intervals of Vs at each content; `outcomes` counts the cells without Vs;
- `stages`: growth rates of the four stages;
- `contact_graph`, `connectivity`, `features`: preferential path, C_d, C_d,n and the eight path features;
- `packing_graph`: the contact graph of a stored packing; `campaign_analysis`: all products of a campaign;
- `correlation`: Pearson and Spearman, over all contents, within one and at each;
- `path_envelope`, `weights`: the best ratio of the contact weights;
- `fits`: Vs = a C^b + c with intervals, leave-one-seed-out error and prediction;
- `predictor`: Vs of samples that were not simulated, with intervals;
- `planning`: number of seeds needed; `measured`: comparison with laboratory velocities;
- `published`: the reproduced study's tables.
"""
