"""The events of the live stream that a viewer can catch up on."""

import time

from app.messages.live import EventMessage
from app.stream.viewers import MAX_KEPT_EVENTS, ViewerHub


def event(text: str) -> EventMessage:
    return EventMessage(server_time_ms=0.0, text=text)


def test_the_events_after_a_number_are_all_of_them_or_none() -> None:
    hub = ViewerHub(8)
    begin = hub.newest_event_number
    assert hub.list_events_after(begin) == []
    for number in range(MAX_KEPT_EVENTS + 5):
        hub.broadcast(event(f"{number}"))
    newest = hub.newest_event_number
    assert newest == begin + MAX_KEPT_EVENTS + 5
    assert hub.list_events_after(newest) == []
    assert [each.text for each in hub.list_events_after(newest - 2) or ()] == ["1003", "1004"]
    kept = hub.list_events_after(newest - MAX_KEPT_EVENTS)
    assert [each.number for each in kept or ()] == list(range(begin + 6, newest + 1))
    assert hub.list_events_after(newest - MAX_KEPT_EVENTS - 1) is None
    assert hub.list_events_after(newest + 1) is None


def test_the_numbers_of_a_later_service_are_greater() -> None:
    earlier = ViewerHub(8)
    for _ in range(3):
        earlier.broadcast(event("said before the service was started again"))
    time.sleep(0.01)  # no service starts again as fast
    assert ViewerHub(8).list_events_after(earlier.newest_event_number - 1) is None
