"""The halo's coarse renders: rectangles of one frame share their plans."""

from gpusim.camera import load_camera
from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.render import Renderer, planning
from gpusim.scene import make_scene


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
