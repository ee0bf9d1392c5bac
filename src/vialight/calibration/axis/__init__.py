"""Where the rotation axis is, how it leans, how the vial goes round it, and which way the stage turns."""
