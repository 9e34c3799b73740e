"""What OpenAPI says beyond the types."""
