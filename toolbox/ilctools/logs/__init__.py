"""Logs of trials and tables that others wrote."""
