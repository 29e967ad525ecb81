"""What a run writes and shows: folders of results, progress, live views."""
