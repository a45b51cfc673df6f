"""What is computed from rendered light: statistics of estimates."""
