"""Results of a campaign for people: a page, a folder of figures and tables, and figures of one sample."""
