"""Sweeps: variants x drives x seeds, on the processes of one machine or on a cluster."""

#: figures of merit by their name in a file, with the heading of their column
MEASURES = {
    "precision_at_100_recall": "P@100R",
    "recall_at_99_precision": "R@99P",
    "average_precision": "AP",
    "recall_at_1": "Recall@1",
    "recall_at_5": "Recall@5",
    "recall_at_10": "Recall@10",
    "queries": "judged windows",
    "packed_bytes_per_window": "bytes per window",
    "differences_per_match": "differences per match",
    "microseconds_per_match": "µs per match",
}
