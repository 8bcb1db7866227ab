"""Catalogues of many recordings: losses, stores, costs."""
