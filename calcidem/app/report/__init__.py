"""What a campaign says, for people: a page, a folder of figures and tables, and a closer look at one sample."""
