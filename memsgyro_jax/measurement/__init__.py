"""What a laboratory records (case), how a model predicts it (experiments), and how the two meet (readings)."""
