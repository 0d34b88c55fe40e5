"""How long answers to requests with a key are kept."""

import asyncio

from app.http.idempotency import KEEP_S, MAX_KEYS_PER_PERSON, IdempotentAnswers
from app.messages.runs import StopRequest


def test_keys_are_kept_for_a_day_and_a_bounded_number_of_each_person() -> None:
    now_s, carried_out = 0.0, 0

    async def carry_out() -> int:
        nonlocal carried_out
        carried_out += 1
        return carried_out

    async def program() -> None:
        nonlocal now_s
        answers = IdempotentAnswers[int](lambda: now_s)

        async def ask(person: str, key: str) -> int:
            return await answers.answer_once(person, key, StopRequest(), carry_out)

        first = await ask("Ada", "0")
        now_s = KEEP_S - 1
        assert await ask("Ada", "0") == first
        now_s = KEEP_S
        second = await ask("Ada", "0")
        assert second != first
        for number in range(MAX_KEYS_PER_PERSON - 1):
            await ask("Otto", f"{number}")
            await ask("Ada", f"{number + 1}")
        assert await ask("Ada", "0") == second
        await ask("Ada", "one more")
        assert await ask("Ada", "0") != second

    asyncio.run(program())
