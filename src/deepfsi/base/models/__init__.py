"""Bases of models of settings and of what files hold, with pydantic."""
