"""What any program needs: errors, settings, files, tables, progress, intervals."""
