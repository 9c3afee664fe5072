"""The lab server: one scanner, one operator at a time, everybody else watches; by browser and by HTTP."""
