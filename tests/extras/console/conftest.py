"""Run tests that are coroutines, each in an event loop of its own."""

import asyncio
import inspect

import pytest

PATIENCE_S = 110.0  # ends a test that would hang; on a busy machine a hit compiles for a minute


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.obj).parameters}

    async def within_time() -> None:
        async with asyncio.timeout(PATIENCE_S):
            await pyfuncitem.obj(**arguments)

    asyncio.run(within_time())
    return True
