"""Waters by name, what each resolves to, and its whole phase function."""
