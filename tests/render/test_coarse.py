"""The halo's coarse renders: rectangles of one frame share their plans, or one halo."""

import pytest

from gpusim.camera import load_camera
from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.render import Renderer, planning
from gpusim.scene import make_scene


@pytest.mark.slow
def test_parts_of_a_rectangle_whose_halo_is_held_have_it():
    camera, scene = load_camera("machine-vision"), make_scene("slanted-edge")
    made, light = [], Renderer._coarse_light

    class Counted(Renderer):
        def _coarse_light(self, *given):
            made.append(given)
            return light(self, *given)

    def rates(of: Renderer) -> list:
        tiles = (0, 64, 16, 16), (256, 64, 16, 16)
        return [of.capture(0.01, tile=tile, keep=("rate",)).rate for tile in tiles]

    shared, alone = (Counted(camera, scene, Accuracy(1e-2, 0), costs=LAVAPIPE) for _ in range(2))
    shared.hold_halo((64, 0, 16, 272), lambda what, done, total: None)
    levels = len(made)
    held = rates(shared)
    assert levels == len(shared.plan.halo) == len(made)
    # No level is cut: it is a tail itself.
    scales = [scale.name for plan in shared.coarse_plans.values() for scale in plan.scales]
    assert scales == ["whole"] * levels
    own = rates(alone)
    assert len(made) == 3 * levels
    assert all((a == b).all() for a, b in zip(held, own, strict=True))
    shared.release()
    alone.release()


def test_rectangles_share_the_plans_of_the_halo(monkeypatch):
    made, plans_optics = [], planning.plans_optics

    def counted(*given, **more):
        made.append(given)
        return plans_optics(*given, **more)

    monkeypatch.setattr(planning, "plans_optics", counted)
    camera, scene = load_camera("machine-vision"), make_scene("slanted-edge")

    def renderer() -> Renderer:
        return Renderer(camera, scene, Accuracy(1e-2, 0), costs=LAVAPIPE)

    def rate(of: Renderer, left: int):
        return of.capture(0.01, tile=(left, 64, 16, 16), keep=("rate",)).rate

    shared = renderer()
    rate(shared, 0)
    levels = len(shared.plan.halo)
    assert levels and len(made) == 1 + levels
    second = rate(shared, 256)
    assert len(made) == 1 + levels
    alone = renderer()
    assert (rate(alone, 256) == second).all()
    shared.release()
    alone.release()
