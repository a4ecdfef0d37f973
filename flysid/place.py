"""Object stores: `s3://`, `gs://` and `az://`, with conditional writes.

A place is an address and nothing else. Its client is made when it is first used, and in each process anew,
with the provider's own chain of credentials (environment, instance, workload identity): a place that is
pickled, shown or logged holds no secret, and an address that does is refused.

`create` is what commits rest on: of all who create one key, one succeeds. Not every server of the S3 protocol
keeps that promise, so `require_conditions` tries it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flysid.errors import PlaceError, UsageError
from flysid.files import writing_to

if TYPE_CHECKING:
    from obstore import UpdateVersion

SCHEMES = ("s3", "gs", "az")
_CREDENTIALS = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the machine's own role",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS, or the machine's own account",
    "az": "AZURE_STORAGE_ACCOUNT_NAME with AZURE_STORAGE_ACCOUNT_KEY, or the machine's own identity",
}


def is_address(text: str | Path) -> bool:
    """Whether a text names an object store, not a path."""
    return "://" in str(text)


@dataclass(frozen=True)
class StoredObject:
    """An object: its key below the place, its size, the store's tag of its content, when it arrived."""

    key: str
    size: int
    etag: str
    modified: datetime


@dataclass(frozen=True)
class Place:
    """An address in an object store, e.g. `s3://bucket/lake`; keys are relative to it."""

    address: str

    def __post_init__(self) -> None:
        scheme, _, rest = self.address.partition("://")
        bucket = rest.partition("/")[0]
        if scheme not in SCHEMES or not bucket:
            raise UsageError(
                "not an address of an object store",
                path=self.address,
                hint="s3://BUCKET/FOLDER, gs:// or az://",
            )
        if set("@?#") & set(rest):
            raise UsageError(
                "an address holds a bucket and a folder, no credentials and no query",
                path=f"{scheme}://...",
                hint=f"give credentials by the provider's own means: {_CREDENTIALS[scheme]}",
            )

    def __getstate__(self) -> dict[str, str]:
        return {"address": self.address}  # the client stays in its process

    def __setstate__(self, state: dict[str, str]) -> None:
        self.__dict__.update(state)

    def __str__(self) -> str:
        return self.address.rstrip("/")

    def at(self, key: str) -> str:
        """The address of a key."""
        return f"{self}/{key}" if key else str(self)

    def below(self, key: str) -> Place:
        """The place of a folder in it."""
        return Place(self.at(key))

    @cached_property
    def _store(self) -> Any:
        try:
            from obstore.store import from_url
        except ImportError as error:
            raise UsageError(
                "object stores need the extra flysid[fleet]",
                path=self.address,
                hint="pip install 'flysid[fleet]'",
            ) from error
        with self._asking(""):
            return from_url(
                str(self),
                client_options={
                    "connect_timeout": timedelta(seconds=10),
                    "timeout": timedelta(minutes=10),
                    "allow_http": os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("1", "true"),
                },
                retry_config={
                    "max_retries": 10,
                    "retry_timeout": timedelta(seconds=90),
                    "backoff": {
                        "base": 2,
                        "init_backoff": timedelta(milliseconds=100),
                        "max_backoff": timedelta(seconds=15),
                    },
                },
            )

    # ------------------------------------------------------------------------------------- reading

    def read(self, key: str) -> bytes:
        """An object's content. Raises FileNotFoundError where there is none, PlaceError."""
        import obstore

        with self._asking(key):
            return bytes(obstore.get(self._store, key).bytes())

    def read_beginnings(self, objects: Sequence[StoredObject], count: int) -> Iterator[bytes]:
        """The first `count` bytes of objects, or all that they have; many requests at once, in order.

        Of an object that is gone there are none.
        """
        import obstore

        def read(found: StoredObject) -> bytes:
            with suppress(FileNotFoundError), self._asking(found.key):
                answer = obstore.get(self._store, found.key, options={"range": (0, min(count, found.size))})
                return bytes(answer.bytes())
            return b""

        yield from _at_once(read, objects)

    def read_tagged(self, key: str) -> tuple[bytes, UpdateVersion]:
        """An object's content, and what `replace` knows it by: its tag, on Google its generation."""
        import obstore

        with self._asking(key):
            answer = obstore.get(self._store, key)
            meta = answer.meta
            tag: UpdateVersion = {}
            if meta["e_tag"]:
                tag["e_tag"] = meta["e_tag"]
            if meta["version"]:
                tag["version"] = meta["version"]
            return bytes(answer.bytes()), tag

    def read_if_there(self, key: str) -> bytes | None:
        """An object's content; None where there is no such object."""
        try:
            return self.read(key)
        except FileNotFoundError:
            return None

    def read_many(self, keys: Sequence[str]) -> Iterator[tuple[str, bytes | None]]:
        """Keys with their content, None where an object is gone; many requests at once, in order."""
        yield from zip(keys, _at_once(self.read_if_there, keys), strict=True)

    def fetch(self, key: str, path: Path) -> None:
        """An object into a file, part by part."""
        import obstore

        with self._asking(key):
            answer = obstore.get(self._store, key)
            with writing_to(path), path.open("wb") as file:
                for chunk in answer.stream(min_chunk_size=4 << 20):
                    file.write(chunk)

    def head(self, key: str) -> StoredObject | None:
        """What is known of one object; None where there is none."""
        import obstore

        try:
            with self._asking(key):
                return _found(obstore.head(self._store, key))
        except FileNotFoundError:
            return None

    def list(self, below: str = "", after: str = "") -> Iterator[StoredObject]:
        """Objects below a folder, by key; a thousand a request. `after`: only keys that come later."""
        import obstore

        with self._asking(below):
            pages = obstore.list(self._store, prefix=below or None, offset=after or None, chunk_size=1000)
            for page in pages:
                for meta in page:
                    yield _found(meta)

    def names(self, folder: str = "") -> Collection[str]:
        """Names of the objects that lie in a folder itself, not below it."""
        import obstore

        with self._asking(folder):
            found = obstore.list_with_delimiter(self._store, prefix=folder or None)
            return [meta["path"].rpartition("/")[2] for meta in found["objects"]]

    # ------------------------------------------------------------------------------------- writing

    def put(self, key: str, content: bytes | Path) -> None:
        """Write an object, whatever was there."""
        import obstore

        with self._asking(key):
            obstore.put(self._store, key, content)

    def put_many(self, contents: Sequence[tuple[str, Path]]) -> None:
        """Write several objects, many requests at once; returns when all are there."""
        list(_at_once(lambda one: self.put(*one), contents))

    def create(self, key: str, content: bytes) -> bool:
        """Write an object unless there is one; whether it was written. Of many at once, one succeeds."""
        import obstore
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        with self._asking(key):
            try:
                obstore.put(self._store, key, content, mode="create", use_multipart=False)
            except (AlreadyExistsError, PreconditionError):
                return False
        return True

    def replace(self, key: str, content: bytes, tag: UpdateVersion) -> bool:
        """Write an object if it is still the one with this tag; whether it was written."""
        import obstore
        from obstore.exceptions import PreconditionError

        with self._asking(key):
            try:
                obstore.put(self._store, key, content, mode=tag, use_multipart=False)
            except PreconditionError:
                return False
        return True

    def delete(self, keys: Iterable[str]) -> None:
        """Remove objects; those that are gone are no error."""
        import obstore

        names = list(keys)
        with self._asking(names[0] if names else ""):
            for start in range(0, len(names), 1000):
                part = names[start : start + 1000]
                try:
                    obstore.delete(self._store, part)
                except FileNotFoundError:  # S3 does not mind; others stop at the first that is gone
                    list(_at_once(self._delete_if_there, part))

    def _delete_if_there(self, key: str) -> None:
        import obstore

        with suppress(FileNotFoundError), self._asking(key):
            obstore.delete(self._store, key)

    def require_conditions(self, key: str, content: bytes, *, racers: int = 4) -> None:
        """Ask the store whether it keeps what `create` promises, with an object that belongs there.

        Creates the object if it is not there, from several threads at once: at most one may succeed, and
        another attempt must be refused. A store that takes the condition and writes all the same would let
        two writers commit one flight twice. Raises UsageError: it does not.
        """
        is_new = self.head(key) is None
        won = sum(_at_once(lambda _: self.create(key, content), range(racers if is_new else 1)))
        if won > is_new or (is_new and self.create(key, content)):
            if is_new:
                self.delete([key])
            raise UsageError(
                "this store accepts 'If-None-Match: *' and writes all the same",
                path=self.address,
                hint="use a store with conditional writes (S3, GCS, Azure, SeaweedFS from 4.17 on); "
                "a gateway before it may drop the condition",
            )

    @contextmanager
    def _asking(self, key: str) -> Iterator[None]:
        """Turn what the client raises into flysid's own words; what is not there stays FileNotFoundError."""
        from obstore import exceptions

        where = self.at(key)
        scheme = self.address.partition("://")[0]
        try:
            yield
        except FileNotFoundError as error:
            if "NoSuchBucket" in str(error) or "ContainerNotFound" in str(error):
                raise _no_bucket(where) from None
            raise FileNotFoundError(where) from None
        except (exceptions.PermissionDeniedError, exceptions.UnauthenticatedError) as error:
            raise UsageError(
                f"the store refuses: {_code(error)}",
                path=where,
                hint=f"check the credentials: {_CREDENTIALS[scheme]}; and what they may do there",
            ) from None
        except exceptions.BaseError as error:
            text = str(error)
            if "NoSuchBucket" in text or "ContainerNotFound" in text:
                raise _no_bucket(where) from None
            if _NO_CREDENTIALS.search(text):
                raise UsageError(
                    "no credentials for this store", path=where, hint=_CREDENTIALS[scheme]
                ) from None
            raise PlaceError(
                f"the store did not answer as it should: {_code(error)}",
                path=where,
                hint="nothing that is committed is lost: run the same command again when it answers",
            ) from None


_NO_CREDENTIALS = re.compile(
    r"/latest/api/token|/latest/meta-data|computeMetadata|identity/oauth2|MissingAccount"
)


def _code(error: Exception) -> str:
    """The server's own word for what happened; no part of a request's signature or headers."""
    text = str(error)
    named = re.search(r"<Code>(\w+)</Code>", text)
    status = re.search(r"status code: (\d+ [A-Za-z ]+)", text)
    if named:
        return named[1]
    if status:
        return status[1].strip()
    if "HTTP error" in text:
        return "no connection"
    return text.splitlines()[0].partition(" http")[0][:120]


def _no_bucket(where: str) -> UsageError:
    return UsageError("no such bucket", path=where, hint="make it first, or check the name and the endpoint")


def _found(meta: Any) -> StoredObject:
    etag = str(meta["e_tag"] or "")
    if etag and not etag.endswith('"'):
        etag = f'"{etag}"'  # Azure leaves the marks out where it lists, not where one object is fetched
    return StoredObject(str(meta["path"]), int(meta["size"]), etag, meta["last_modified"])


def _at_once(do: Callable[[Any], Any], tasks: Iterable[Any], *, most: int = 16) -> Iterator[Any]:
    with ThreadPoolExecutor(most) as pool:
        yield from pool.map(do, tasks)
