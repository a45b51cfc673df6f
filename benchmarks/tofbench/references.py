def reference_cases():
    return []
