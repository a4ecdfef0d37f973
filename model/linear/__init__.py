"""Linear difference equations: data, orders, error minimisation, uncertainty, words."""
