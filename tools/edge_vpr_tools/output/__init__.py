"""Output of a run: folders of results, progress, live views."""
