"""What the resin needs: critical exposure, penetration depth, and index."""
