"""Twin of a real multi-zone sensor: rendered histograms and histograms of a public data set."""
