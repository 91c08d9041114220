"""Figures of palr-gym and what they are compared with. See bench/README.md."""
