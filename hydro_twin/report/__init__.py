"""The same result for a person: figures, tables, pages."""
