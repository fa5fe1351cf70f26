"""What must hold whatever happens: invariants, books, random worlds."""
