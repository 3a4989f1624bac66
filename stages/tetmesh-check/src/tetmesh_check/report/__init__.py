"""Pictures of a case, and its report page."""
