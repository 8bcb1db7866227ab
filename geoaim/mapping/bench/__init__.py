"""How well a stage works on one's own video; tables and charts of measurements."""
