"""The class IdempotentAnswers: answers kept under the `Idempotency-Key`, so that a repeated request changes nothing."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Generic, TypeVar

from pydantic import BaseModel

from app.http.problems import ProblemError

KEEP_S = 24 * 3600.0
MAX_KEYS_PER_PERSON = 200
OTHER_BODY_TEXT = (
    "This Idempotency-Key was sent with another body before. Use a new key for each new request, and repeat a request "
    "with the same body."
)
Answer = TypeVar("Answer")


@dataclass(eq=False, slots=True)
class _KeyedRequest(Generic[Answer]):
    body: BaseModel
    received_s: float
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)
    answer: Answer | None = None


class IdempotentAnswers(Generic[Answer]):
    """The answers of one kind of request, by person and key: nobody receives the answer to another person's request.

    A key is kept for `KEEP_S`, and no longer than the service runs; of each person the last `MAX_KEYS_PER_PERSON`.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._requests: dict[str | None, dict[str, _KeyedRequest[Answer]]] = {}  # each person's oldest key first

    async def answer_once(
        self, person: str | None, key: str | None, body: BaseModel, carry_out: Callable[[], Awaitable[Answer]]
    ) -> Answer:
        """Return the kept answer, else that of `carry_out`, and keep it; without a key, always carry out.

        A repeat that arrives while the first request is under way waits for it. An error is not kept: the next request
        with the key is carried out.

        Raises:
            ProblemError: the person has sent the key with another body.
        """
        if key is None:
            return await carry_out()
        request = self._find_or_add(person, key, body)
        if request.body != body:
            raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, OTHER_BODY_TEXT, "Idempotency-Key")
        async with request.lock:
            if request.answer is None:
                request.answer = await carry_out()
            return request.answer

    def _find_or_add(self, person: str | None, key: str, body: BaseModel) -> _KeyedRequest[Answer]:
        now_s = self._clock()
        kept = {
            known: request
            for known, request in self._requests.get(person, {}).items()
            if now_s - request.received_s < KEEP_S
        }
        request = kept.setdefault(key, _KeyedRequest(body, now_s))
        self._requests[person] = dict(list(kept.items())[-MAX_KEYS_PER_PERSON:])
        return request
