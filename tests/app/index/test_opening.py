"""Opening an index: migration of an older one, and one clear message for each that cannot be opened."""

import multiprocessing
import os
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from messages import alarm, grasp, line, record, run
from recorded import READERS, write_recording
from sqlalchemy import URL, text

from app.index import database, index_lock
from app.index.database import REVISION_TABLE, make_engine, newest_revision, read_revision, resolve_index_url
from app.index.opening import open_store_for_service
from app.index.queries import AuditQuery, FileQuery, GraspQuery
from app.index.rebuild import BEHIND_MARKER_FILE
from app.index.store import Store
from app.index.tables import IndexTable
from config.errors import ConfigurationError, GraspwatchError, ServiceError


def test_the_migrations_make_exactly_the_tables_of_the_code(url: URL, store: Store) -> None:
    engine = make_engine(url)
    with engine.connect() as connection:
        options = {"compare_type": True, "compare_server_default": True, "version_table": REVISION_TABLE}
        context = MigrationContext.configure(connection, opts=options)
        assert compare_metadata(context, IndexTable.metadata) == []
    engine.dispose()


def make_first_index(url: URL, monkeypatch: pytest.MonkeyPatch) -> None:
    """An index as the first revision had it, with a run, two grasps and a recording."""
    with monkeypatch.context() as patch:
        upgrade = database.command.upgrade
        patch.setattr(database.command, "upgrade", lambda configuration, _: upgrade(configuration, "0001"))
        engine = make_engine(url)
        database.migrate(engine)
    with engine.begin() as connection:
        run_json = run(state="finished").model_dump_json()
        grasps = [grasp(index=1), grasp(index=2, held_back=True)]
        file = record().model_dump_json(exclude={"deleted_at", "deleted_by"})
        connection.execute(
            text(
                "INSERT INTO runs (id, protocol, state, started_ms, grasps, message) "
                "VALUES ('run-001', 'sine', 'finished', 1.0, 2, :m)"
            ),
            {"m": run_json},
        )
        for index, each in enumerate(grasps, 1):
            connection.execute(
                text(
                    'INSERT INTO grasps (run_id, "index", label, valid, message) '
                    "VALUES ('run-001', :i, 'liver', :v, :m)"
                ),
                {"i": index, "v": True, "m": each.model_dump_json()},
            )
        connection.execute(
            text(
                "INSERT INTO files (name, run_id, size_bytes, made_ms, message) "
                "VALUES ('run-001.rec', 'run-001', 1000, 1.0, :m)"
            ),
            {"m": file},
        )
    engine.dispose()


def test_an_older_index_is_migrated_with_all_that_is_in_it(url: URL, monkeypatch: pytest.MonkeyPatch) -> None:
    make_first_index(url, monkeypatch)
    store = Store(url)
    engine = make_engine(url)
    with engine.connect() as connection:
        assert read_revision(connection) == newest_revision()
        rows = connection.execute(text('SELECT held_back FROM grasps ORDER BY "index"')).scalars().all()
        assert [bool(row) for row in rows] == [False, True]
        context = MigrationContext.configure(connection, opts={"version_table": REVISION_TABLE})
        assert compare_metadata(context, IndexTable.metadata) == []
    engine.dispose()
    assert store.get_run("run-001") == run(state="finished", grasps=2)
    assert store.find_grasps(GraspQuery()).total == 2
    assert store.find_files(FileQuery(deleted=False)).items == [record()]
    store.close()


def test_a_migration_that_fails_leaves_the_older_index_as_it_was(url: URL, monkeypatch: pytest.MonkeyPatch) -> None:
    make_first_index(url, monkeypatch)
    upgrade = database.command.upgrade

    def fail(configuration: object, revision: str) -> None:
        upgrade(configuration, revision)
        raise ServiceError("the power went out")

    with monkeypatch.context() as patch:
        patch.setattr(database.command, "upgrade", fail)
        with pytest.raises(ServiceError, match="power"):
            Store(url)
    engine = make_engine(url)
    with engine.connect() as connection:
        assert read_revision(connection) == "0001"
        assert connection.scalar(text("SELECT count(*) FROM grasps")) == 2
    engine.dispose()
    Store(url).close()


def test_an_index_of_a_newer_program_is_refused_and_left_alone(url: URL) -> None:
    Store(url).close()
    engine = make_engine(url)
    with engine.begin() as connection:
        connection.execute(text(f"UPDATE {REVISION_TABLE} SET version_num = '9999'"))
    engine.dispose()
    with pytest.raises(ServiceError, match=r"a newer Graspwatch made it \(revision 9999.*graspwatch index --rebuild"):
        Store(url)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"no database at all, but quite long, long enough for a header of a hundred bytes or so" * 50, "no database"),
        (b"SQLite format 3\0" + b"\xff" * 5000, "no database|damaged"),
    ],
)
def test_a_damaged_file_is_refused_and_left_alone(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "index.sqlite"
    path.write_bytes(content)
    with pytest.raises(ServiceError, match=f"({says}).*graspwatch index --rebuild"):
        Store(resolve_index_url(None, tmp_path))
    assert path.read_bytes() == content


def test_a_page_that_was_overwritten_is_noticed(tmp_path: Path) -> None:
    url = resolve_index_url(None, tmp_path)
    store = Store(url)
    store.ingest_all((line(number, "x" * 500), None) for number in range(200))
    store.close()
    path = tmp_path / "index.sqlite"
    content = bytearray(path.read_bytes())
    middle = len(content) // 8192 * 4096
    content[middle : middle + 8192] = b"\x5a" * 8192
    path.write_bytes(content)
    with pytest.raises(ServiceError, match=r"it is damaged.*graspwatch index --rebuild"):
        Store(url)


def test_a_database_of_something_else_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "index.sqlite") as connection:
        connection.execute("CREATE TABLE patients (name TEXT)")
    connection.close()
    before = (tmp_path / "index.sqlite").read_bytes()
    with pytest.raises(ServiceError, match=r"of something else .*'patients'.*graspwatch index --rebuild"):
        Store(resolve_index_url(None, tmp_path))
    assert (tmp_path / "index.sqlite").read_bytes() == before


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("nonsense", "no address of a database"),
        ("postgresql://ada:secret@db:port/x", "no address of a database"),
        ("sqlite:///x?mode=memory", "'sqlite' does not do"),
        ("mysql://ada:secret@db/x", "'mysql' does not do"),
        ("sqlite://", "'sqlite' does not do"),
    ],
)
def test_a_wrong_address_is_refused_without_its_password(tmp_path: Path, setting: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=says) as refused:
        resolve_index_url(setting, tmp_path)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"password": "wrong-secret"}, "the password is wrong: put the right one into index_url or ~/.pgpass"),
        ({"database": "nowhere"}, "there is no such database.*createdb"),
        ({"query": {"host": "/nowhere"}}, "nothing listens there: start the server"),
        ({"host": "127.0.0.1", "port": 1, "query": {}}, "nothing listens there: start the server"),
        ({"host": "nowhere.invalid", "query": {}}, "there is no such host"),
    ],
)
def test_a_server_that_does_not_let_us_in_is_one_clear_message(
    server: str, tmp_path: Path, change: dict[str, object], says: str
) -> None:
    url = resolve_index_url(server.format("postgres"), tmp_path).set(**change)
    with pytest.raises(ServiceError, match=says) as refused:
        Store(url)
    assert "secret" not in str(refused.value)


def test_a_missing_driver_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'graspwatch\[postgresql\]'"):
        Store(resolve_index_url("postgresql://ada@db/x", tmp_path))


def refusal_for_nobody(folder: Path, answers: multiprocessing.SimpleQueue) -> None:
    """Root may write everywhere; nobody may not."""
    if os.getuid() == 0:
        os.setgid(65534)
        os.setuid(65534)
    try:
        Store(resolve_index_url(None, folder))
        answers.put("it was opened")
    except ServiceError as error:
        answers.put(str(error))


@pytest.mark.parametrize(
    ("folder_mode", "file_mode", "says"),
    [(0o555, 0o644, "cannot be written (Permission denied)"), (0o777, 0o444, "read-only: allow writing")],
)
def test_what_is_read_only_is_one_clear_message(folder_mode: int, file_mode: int, says: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Store(resolve_index_url(None, folder)).close()
        (folder / "index.sqlite").chmod(file_mode)
        (folder / "index.sqlite.lock").chmod(0o666 if folder_mode == 0o777 else 0o444)
        folder.chmod(folder_mode)
        context = multiprocessing.get_context("fork")
        answers = context.SimpleQueue()
        process = context.Process(target=refusal_for_nobody, args=(folder, answers))
        process.start()
        process.join(30)
        assert says in answers.get()
        folder.chmod(0o755)


def test_a_folder_that_is_gone_is_one_clear_message(tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match=r"cannot be written \(No such file"):
        Store(resolve_index_url(None, tmp_path / "gone"))


def test_lines_that_the_index_missed_are_taken_at_the_next_start(url: URL, tmp_path: Path) -> None:
    store = Store(url)
    first, second = line(1, "Run started", kind="run", run=run()), line(2, "An alarm", kind="alarm", alarm=alarm())
    store.ingest(first)
    store.close()
    torn = second.to_line()[:40]
    (tmp_path / "journal.jsonl").write_text(f"{first.to_line()}\n{second.to_line()}\n{torn}")
    store = open_store_for_service(url, tmp_path, READERS)
    assert [each.text for each in store.find_audit_entries(AuditQuery(order="oldest")).items] == [
        "Run started",
        "An alarm",
    ]
    assert store.had_no_other_user
    store.close()


@pytest.mark.parametrize(("recordings", "behind"), [(3, False), (4, True)])
def test_the_recording_of_a_killed_service_is_taken_at_the_next_start(
    url: URL, tmp_path: Path, recordings: int, behind: bool
) -> None:
    for number in range(recordings):
        write_recording(tmp_path, record(number), [run(number), grasp(number)])
    store = open_store_for_service(url, tmp_path, READERS)
    assert store.find_grasps(GraspQuery()).total == (0 if behind else recordings)
    assert (tmp_path / BEHIND_MARKER_FILE).exists() is behind
    store.close()


def test_only_one_that_comes_alone_may_say_what_is_under_way(url: URL, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index_lock, "LOCK_TIMEOUT_S", 0.1)
    one, two = Store(url), Store(url)
    assert (one.had_no_other_user, two.had_no_other_user) == (True, False)
    with pytest.raises(ServiceError, match="A service uses the index"):
        Store(url, exclusive=True)
    one.close()
    two.close()
    alone = Store(url, exclusive=True)
    with pytest.raises(ServiceError, match="is being rebuilt"):
        Store(url)
    alone.close()


def test_the_claim_of_a_killed_process_is_gone(tmp_path: Path) -> None:
    code = (
        "import os,sys; from pathlib import Path; from app.index.store import Store; "
        "from app.index.database import resolve_index_url; s = Store(resolve_index_url(None, Path(sys.argv[1]))); "
        "os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert done.returncode == -9
    store = Store(resolve_index_url(None, tmp_path), exclusive=True)
    store.close()


def test_errors_have_their_exit_codes() -> None:
    assert issubclass(ServiceError, GraspwatchError)
    assert (ConfigurationError.exit_code, ServiceError.exit_code) == (2, 6)
