"""Design and hardware together: counts to classes, designs to patterns, live runs."""
