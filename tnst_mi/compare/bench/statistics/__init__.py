"""Whether two that were measured in batches are equal."""
