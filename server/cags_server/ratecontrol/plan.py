"""A plan under construction: tiles rising level by level until budget or room is used up."""

from __future__ import annotations

from cags_server.ratecontrol.base import Decision, Observation, TileView, Upgrade

ALONE_FRAMES = 10
"""Detail that is larger than the budget may take the link for so many frames. What begins later is not in the
observation, and would wait for it.
"""


class Plan:
    """Raises tiles within the observation's budget and room, and turns the result into a decision."""

    def __init__(self, observation: Observation) -> None:
        self._budget, self._timely = observation.budget_bytes, observation.timely_bytes
        self._alone = observation.alone_bytes
        self._detail_alone = min(self._alone, ALONE_FRAMES * observation.frame_bytes)
        self._spent = self._urgent = 0  # in all, and of it on what must arrive in time
        self._overhead = observation.message_overhead_bytes
        self._layered = observation.layered
        self._start = {(tile.frame, tile.tile): tile.depth for tile in observation.tiles}
        self._depth = dict(self._start)
        self._frame = observation.frame
        self._passing = {(tile.frame, tile.tile): tile.passing for tile in observation.tiles}
        self._together: dict[tuple[int, int], int] = {}
        self._order: list[tuple[int, int]] = []

    def depth(self, tile: TileView) -> int:
        """LoDs of ``tile`` with what is planned so far."""
        return self._depth[tile.frame, tile.tile]

    def raise_once(self, tile: TileView) -> bool:
        """Plan one more LoD of ``tile``.

        False where it has none, or there is no budget or no room for it, or it lacks the tile that it comes after.
        """
        key = (tile.frame, tile.tile)
        depth = self._depth[key]
        if depth >= tile.max_depth or self.lacks(tile):
            return False
        fresh = depth == self._start[key]
        cost = tile.lod_bytes[depth] + (self._overhead if fresh else 0)
        if not self._layered and not fresh:  # the whole tile at the better quality goes instead
            cost -= tile.lod_bytes[depth - 1]
        urgent = self._urgent_now(tile, depth)
        if not (self._fits(cost, urgent=urgent) or self._goes_alone(tile, cost)):
            return False
        self._spent += cost
        self._urgent += cost * urgent
        self._depth[key] = depth + 1
        if fresh:
            self._order.append(key)
        return True

    def raise_together(self, tile: TileView, to_lod: int) -> bool:
        """Plan the first ``to_lod`` LoDs of ``tile``, of which the client has none, all or nothing.

        False where there is no budget or no room for all of them, or the tile that it comes after is missing.
        """
        key = (tile.frame, tile.tile)
        if self._depth[key] or self.lacks(tile):
            return False
        cost = sum(tile.lod_bytes[:to_lod]) + self._overhead
        urgent = tile.frame <= self._frame
        if not (self._fits(cost, urgent=urgent) or self._goes_alone(tile, cost)):
            return False
        self._spent += cost
        self._urgent += cost * urgent
        self._depth[key] = self._together[key] = to_lod
        self._order.append(key)
        return True

    def lacks(self, tile: TileView) -> bool:
        """Whether ``tile`` is worth nothing so far, for want of the tile that it comes after."""
        return tile.after is not None and not self._depth.get(tile.after, 0)

    def _urgent_now(self, tile: TileView, depth: int) -> bool:
        """Whether what is planned next must arrive before the frame is displayed."""
        if tile.frame > self._frame:  # it begins later
            return False
        return depth == 0 or tile.passing or (not self._layered and self._start[tile.frame, tile.tile] == 0)

    def _fits(self, cost: int, *, urgent: bool) -> bool:
        arrives = not urgent or self._urgent + cost <= self._timely
        return arrives and self._spent + cost <= self._budget

    def _goes_alone(self, tile: TileView, cost: int) -> bool:
        """Whether ``tile`` may be sent though it is larger than the budget: it stays, and the link has nothing else."""
        most = self._detail_alone if self._start[tile.frame, tile.tile] else self._alone
        return not tile.passing and not self._spent and cost <= most

    def decision(self) -> Decision:
        """The planned upgrades in the order in which their tiles were first raised."""
        upgrades = tuple(
            Upgrade(*key, self._start[key], self._depth[key], self._passing[key], self._together.get(key, 1))
            for key in self._order
        )
        return Decision(upgrades, self._spent)
