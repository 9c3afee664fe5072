"""Drivers of cameras. Photographs are (rows, columns) grey or (rows, columns, 3) in the order red, green, blue."""
