"""What a campaign needs of a machine, each point checked by trying it out."""
