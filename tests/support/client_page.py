"""The page with a client behind it, asked from a test that drives its browser."""

from __future__ import annotations

from typing import Any

_MEASURED = """
const { player } = window.cags ?? {}, shown = player?.shown;
return player && {
  pictures: player.pictures, photonMs: player.photonMs, playing: player.playing, shaper: player.state?.shaper ?? null,
  frame: shown?.frame ?? -1, poseAtUs: shown?.pose_at_us ?? null, stats: shown?.stats ?? {},
  name: shown?.pictures[0]?.name ?? null, codec: shown?.pictures[0]?.codec ?? null,
};
"""
_CHOSEN = """
const control = document.querySelector(arguments[0]);
control.value = arguments[1];
for (const kind of ['input', 'change']) control.dispatchEvent(new Event(kind, { bubbles: true }));
"""


def measured(running: Any) -> dict[str, Any]:
    """What the page's player has counted and shown last."""
    return dict(running.execute_script(_MEASURED) or {"pictures": 0})


def choose(running: Any, selector: str, value: str) -> None:
    """As a visitor's hand does: the control has its new value, and says so."""
    running.execute_script(_CHOSEN, selector, value)


def click(running: Any, selector: str) -> None:
    """Also of what is scrolled out of the inspector."""
    running.execute_script("document.querySelector(arguments[0]).click()", selector)


def drag(running: Any, x: int, y: int, steps: int = 12, step_ms: int = 30) -> None:
    """Move the picture by ``steps`` of so many pixels each."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    actions = ActionChains(running, duration=step_ms).click_and_hold(running.find_element(By.ID, "picture"))
    for _ in range(steps):
        actions.move_by_offset(x, y)
    actions.release().perform()
