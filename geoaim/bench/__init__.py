"""Speed against accuracy, and where methods break: one script a question."""
