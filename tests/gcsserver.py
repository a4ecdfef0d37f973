"""What Google documents of its store's XML interface, on loopback: no server of Google's can be installed.

Objects are kept in memory, each with a generation, and `x-goog-if-generation-match` is obeyed: what commits
rest on, and what the servers that others made leave out. So far as Google's documents are read rightly here,
it shows that the client asks for the right things; how Google's own store answers, it cannot show.
https://cloud.google.com/storage/docs/xml-api/overview
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
import threading
from dataclasses import dataclass
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit
from xml.sax.saxutils import escape

from tests.s3server import S3Server, free_port

BUCKET = "tests"
PAGE = 1000


@dataclass(frozen=True)
class Stored:
    """An object at one time."""

    content: bytes
    generation: int

    @property
    def headers(self) -> dict[str, str]:
        """What an answer says of it."""
        return {
            "ETag": f'"{hashlib.md5(self.content).hexdigest()}"',
            "x-goog-generation": str(self.generation),
        }


class Store(ThreadingHTTPServer):
    """Objects of one bucket, and uploads in parts that are not ended."""

    daemon_threads = True

    def __init__(self, port: int) -> None:
        super().__init__(("127.0.0.1", port), Asked)
        self.lock = threading.Lock()
        self.objects: dict[str, Stored] = {}
        self.uploads: dict[str, dict[int, bytes]] = {}
        self.generation = 0

    def next_generation(self) -> int:
        """A number that no object had before."""
        self.generation += 1
        return self.generation


class Asked(BaseHTTPRequestHandler):
    """One connection."""

    protocol_version = "HTTP/1.1"
    server: Store

    def log_message(self, *_: Any) -> None:
        """Nothing."""

    def do_GET(self) -> None:
        """An object, a part of it, or a page of the list."""
        if not self.key:
            return self._list()
        found = self.server.objects.get(self.key)
        if found is None:
            return self._refuse(404, "NoSuchKey")
        wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        headers = found.headers | {"Last-Modified": formatdate(found.generation, usegmt=True)}
        if wanted is None:
            return self._answer(200, found.content, headers)
        first = int(wanted[1])
        stop = min(len(found.content), int(wanted[2] or len(found.content)) + 1)
        headers["Content-Range"] = f"bytes {first}-{stop - 1}/{len(found.content)}"
        return self._answer(206, found.content[first:stop], headers)

    do_HEAD = do_GET

    def do_PUT(self) -> None:
        """An object, if its generation is the one that is asked for; a copy; or a part of an upload."""
        content = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if "uploadId" in self.query:
            self.server.uploads[self.query["uploadId"]][int(self.query["partNumber"])] = content
            return self._answer(200, b"", {"ETag": f'"{hashlib.md5(content).hexdigest()}"'})
        source = self.headers.get("x-goog-copy-source")
        with self.server.lock:
            if source is not None:
                copied = self.server.objects.get(unquote(source).lstrip("/").partition("/")[2])
                if copied is None:
                    return self._refuse(404, "NoSuchKey")
                content = copied.content
            return self._keep(content, b"<CopyObjectResult/>" if source else b"")

    def do_POST(self) -> None:
        """Begin or end an upload in parts."""
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        with self.server.lock:
            if "uploads" in self.query:
                name = str(self.server.next_generation())
                self.server.uploads[name] = {}
                inner = f"<UploadId>{name}</UploadId>"
                text = f"<InitiateMultipartUploadResult>{inner}</InitiateMultipartUploadResult>"
                return self._answer(200, text.encode())
            parts = self.server.uploads.pop(self.query["uploadId"])
            content = b"".join(parts[number] for number in sorted(parts))
            tag = f"<ETag>{hashlib.md5(content).hexdigest()}</ETag>"
            text = f"<CompleteMultipartUploadResult>{tag}</CompleteMultipartUploadResult>"
            return self._keep(content, text.encode())

    def do_DELETE(self) -> None:
        """Remove an object, or give up an upload."""
        with self.server.lock:
            if "uploadId" in self.query:
                self.server.uploads.pop(self.query["uploadId"], None)
                return self._answer(204)
            if self.server.objects.pop(self.key, None) is None:
                return self._refuse(404, "NoSuchKey")
            return self._answer(204)

    @property
    def key(self) -> str:
        """The object that is asked for; empty for the bucket."""
        return unquote(urlsplit(self.path).path).lstrip("/").partition("/")[2]

    @property
    def query(self) -> dict[str, str]:
        """What stands behind the question mark."""
        return dict(parse_qsl(urlsplit(self.path).query, keep_blank_values=True))

    def _keep(self, content: bytes, answer: bytes) -> None:
        there = self.server.objects.get(self.key)
        wanted = self.headers.get("x-goog-if-generation-match")
        if wanted is not None and int(wanted) != (there.generation if there else 0):
            return self._refuse(412, "PreconditionFailed")
        stored = Stored(content, self.server.next_generation())
        self.server.objects[self.key] = stored
        return self._answer(200, answer, stored.headers)

    def _list(self) -> None:
        bucket = unquote(urlsplit(self.path).path).strip("/")
        if bucket != BUCKET:
            return self._refuse(404, "NoSuchBucket")
        query = self.query
        prefix = query.get("prefix", "")
        after = max(query.get("continuation-token", ""), query.get("start-after", ""))
        with self.server.lock:
            entries = sorted((key, stored) for key, stored in self.server.objects.items())
        found: dict[str, str] = {}
        for key, stored in entries:
            if not key.startswith(prefix) or key <= after:
                continue
            below, cut, _ = key[len(prefix) :].partition(query.get("delimiter") or "\0")
            folder = prefix + below + cut
            if cut:
                found[folder] = f"<CommonPrefixes><Prefix>{escape(folder)}</Prefix></CommonPrefixes>"
                continue
            tag = escape(stored.headers["ETag"])
            facts = f"<Size>{len(stored.content)}</Size><ETag>{tag}</ETag>"
            when = f"<LastModified>1970-01-01T00:00:{stored.generation % 60:02d}.000Z</LastModified>"
            found[key] = f"<Contents><Key>{escape(key)}</Key>{when}{facts}</Contents>"
        page = sorted(found)[:PAGE]
        text = "".join(found[key] for key in page)
        if len(found) > PAGE:
            text += f"<NextContinuationToken>{escape(page[-1])}</NextContinuationToken>"
        return self._answer(200, f"<ListBucketResult>{text}</ListBucketResult>".encode())

    def _refuse(self, status: int, code: str) -> None:
        self._answer(status, f"<Error><Code>{code}</Code></Error>".encode())

    def _answer(self, status: int, content: bytes = b"", headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in (headers or {}).items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


class GoogleServer(S3Server):
    """This server in a process of its own."""

    @property
    def environment(self) -> dict[str, str]:
        """What a client needs: the provider's own file, which says where the store is."""
        account = self.log.with_name("account.json")
        facts = {"gcs_base_url": self.endpoint, "disable_oauth": True}
        names = ("client_email", "private_key", "private_key_id")
        account.write_text(json.dumps(facts | dict.fromkeys(names, "")))
        return {"GOOGLE_SERVICE_ACCOUNT": str(account), "AWS_ALLOW_HTTP": "true"}


def google(folder: Path) -> GoogleServer:
    """A server with one bucket."""
    port = free_port()
    return GoogleServer([sys.executable, "-m", "tests.gcsserver", str(port)], port, folder / "server.log")


if __name__ == "__main__":
    Store(int(sys.argv[1])).serve_forever()
