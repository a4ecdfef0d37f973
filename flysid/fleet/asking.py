"""Questions in SQL about the flights of a lake, or of a folder on this machine."""

from __future__ import annotations

from tempfile import TemporaryDirectory

import pyarrow as pa

from flysid.catalogue import catalogue
from flysid.fleet.lakes import open_lake
from flysid.ingest.lake.flighttable import ask, ask_table, rows_of
from flysid.place import is_address


def answer(lake: str, sql: str) -> pa.Table:
    """What a question about the table `flights` is answered.

    Raises UsageError: no lake and no ingested folder; the question is not understood, or is more than a
    question.
    """
    if is_address(lake):
        return ask(open_lake(lake), sql)
    from deltalake import DeltaTable, write_deltalake

    with TemporaryDirectory() as folder:
        write_deltalake(folder, rows_of(catalogue(lake)))
        return ask_table(DeltaTable(folder), sql, lake)
