"""Evaluation of the velocities of a campaign, from distribution to prediction.

All functions take records, plain arrays or xarray and return frozen records or xarray. None reads a database or
simulates, so the same code serves a campaign, a published table and other data. Import from the modules:

- `distribution`: moments, normality, intervals of Vs at each content; `outcomes` counts the cells without Vs;
- `contact_graph`, `connectivity`: preferential path, C_d and C_d,n;
- `packing_graph`: contact graph of a stored packing, the eight path features;
- `campaign_analysis`: all products of a campaign;
- `correlation`: Pearson and Spearman, over all contents, within one and at each;
- `weights`: the best ratio of the contact weights;
- `fits`: Vs = a C^b + c with intervals, leave-one-seed-out error and prediction;
- `predictor`: Vs of samples that were not simulated, with intervals;
- `planning`: number of seeds needed; `measured`: comparison with laboratory velocities;
- `published`: the reproduced study's tables and its four stages of growth.
"""
