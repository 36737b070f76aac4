"""Pictures of recordings and results, drawn without a display."""
