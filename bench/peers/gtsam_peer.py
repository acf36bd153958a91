try:
    import gtsam
except ImportError as error:
    absent(error)

from importlib.metadata import version

OPTIMISERS = {
    "GaussNewton": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
    "LevenbergMarquardt": (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams),
}


def relax(file, method):
    """A graph from a g2o file, its first pose held; its own iteration limits and tolerances."""
    graph, start = gtsam.readG2o(file, True)
    nodes = sorted(start.keys())
    hold = gtsam.noiseModel.Diagonal.Sigmas(numpy.full(6, 1e-6))
    graph.add(gtsam.PriorFactorPose3(nodes[0], start.atPose3(nodes[0]), hold))
    optimiser, parameters = OPTIMISERS[method]
    begin = milliseconds()
    run = optimiser(graph, start, parameters())
    result = run.optimize()
    end = milliseconds()
    return {
        "ms": end - begin,
        "parts": {"optimise": end - begin},
        "poses": [rows(result.atPose3(node).matrix()) for node in nodes],
        "iterations": int(run.iterations()),
    }


serve("gtsam", version("gtsam"), {"relax": relax})
