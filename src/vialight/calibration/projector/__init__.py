"""Where the projector stands, from the glow of lines that it sweeps through the resin."""
