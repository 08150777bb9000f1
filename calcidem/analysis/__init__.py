"""What the velocities of a campaign say, from distribution to prediction.

Everything here takes plain arrays or xarray and returns frozen records or xarray; nothing reads a database,
so the same code serves a campaign, a table from a paper and somebody else's data. Import from the modules:

- `distribution`: moments, normality, intervals of Vs at each content; `outcomes` counts the cells without Vs;
- `stages`: growth rates of the four stages;
- `contact_graph`, `connectivity`, `features`: preferential path, C_d, C_d,n and the eight path features;
- `correlation`: Pearson and Spearman, over all contents and within one;
- `path_envelope`, `weights`: the best ratio of the contact weights;
- `fits`: Vs = a C^b + c with intervals, leave-one-seed-out error and prediction;
- `planning`: how many seeds are needed;
- `published`, `published_check`: the reproduced study's tables, and whether they agree with themselves.
"""
