from pathlib import Path

from app.messages import json_schema
from app.messages.live import FRAME_HEADER

COMMITTED = Path(json_schema.__file__).parents[2] / "frontend" / "src" / "wire.schema.json"


def test_the_dashboards_types_come_from_the_contract_as_it_is():
    """If this fails: `make wire`, then build and commit."""
    assert COMMITTED.read_text() == json_schema.render_schema()


def test_the_frame_header_has_the_size_that_the_dashboard_decodes():
    assert json_schema.build_schema()["x-frame"]["header_bytes"] == FRAME_HEADER.size == 32
