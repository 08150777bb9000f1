"""One campaign: from a configuration to results in a store, and stored campaigns opened again."""
