"""Campaigns as NetCDF files and xarray datasets."""
