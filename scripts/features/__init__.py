"""How the feature extractors of the lane scenes are made: see scenes/features/README.md."""
