"""Twin of a real multi-zone sensor: rendered histograms against those of a public data set."""
