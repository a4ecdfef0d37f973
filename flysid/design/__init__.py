"""Gains from models, beside the present ones, and their trial flights on simulated vehicles."""
