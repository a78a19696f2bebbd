"""Files to make a unit: drawing, cutter's file, solids, creases, report."""
