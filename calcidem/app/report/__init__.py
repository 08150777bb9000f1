"""The results of a campaign for people: a page, a folder of figures and tables, and a closer look at one sample."""
