"""One campaign: from a configuration to results in a store, and opening of stored campaigns."""
