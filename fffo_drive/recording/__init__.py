"""Recording: MCAP files of rows, events and records, their readers, and the import of foreign tables.

`writer` and `recorder` make files, `reader` gives NumPy columns, `recover` makes torn files whole, `table`
reads CSV and MAT.
"""
