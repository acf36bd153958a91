"""Registration for mirador by small_gicp, in a process of its own.

    [alignment]
    registration = "external"

    [programs.registration]
    command = ["python3", "examples/python_icp/icp.py"]

Both keyframes are read where alignment wrote them. Nothing of ours copies them; small_gicp does: it keeps its points as
four 64-bit numbers each, so `small_gicp.PointCloud` converts them once (32 bytes a point).
"""

import logging
import sys

import mirador_messages as mirador
import numpy
import small_gicp
from mirador_messages import schema

# Points of a keyframe are fitted to the same few returns and do not err independently: that many share one error.
POINTS_PER_INDEPENDENT_ERROR = 24.0
# small_gicp speaks of rotation before translation, mirador of translation before rotation.
ORDER = [3, 4, 5, 0, 1, 2]


def prepare(points: numpy.ndarray):
    """A cloud of small_gicp's with its covariances, and a tree."""
    cloud = small_gicp.PointCloud(points)
    tree = small_gicp.KdTree(cloud)
    small_gicp.estimate_covariances(cloud, tree, num_neighbors=10)
    return cloud, tree


def answer(request: mirador.Message) -> schema.RegistrationResult:
    """What GICP finds between the keyframes of a request."""
    meta, positions = request.meta, request.items["position"]
    logging.debug("%d %d %d", meta.header.id & 0xFFFFFFFF, *mirador.place_of(positions))
    target, target_tree = prepare(positions[: meta.target_points])
    source, _ = prepare(positions[meta.target_points :])
    start = numpy.array(meta.initial_target_from_source).reshape(4, 4)
    # From afar with a wide pair distance, then with a narrow one.
    steps = {"max_iterations": meta.max_iterations, "target_tree": target_tree}
    coarse = small_gicp.align(target, source, init_T_target_source=start,
                              max_correspondence_distance=meta.pair_distance_m, **steps)
    found = small_gicp.align(target, source, init_T_target_source=coarse.T_target_source,
                             max_correspondence_distance=min(0.5, meta.pair_distance_m), **steps)
    result = schema.RegistrationResult(request=meta.request, schema=schema.ANSWER_SCHEMA)
    result.target_from_source[:] = found.T_target_source.ravel()
    result.covariance[:] = covariance(found).ravel()
    result.overlap = found.num_inliers / max(meta.source_points, 1)
    result.iterations = coarse.iterations + found.iterations
    result.converged = int(found.converged)
    return result


def covariance(found: small_gicp.RegistrationResult) -> numpy.ndarray:
    """6x6, translation before rotation, perturbation on the right: the inverse of the Hessian, scaled by what is left of
    the error."""
    variance = 2.0 * found.error / max(3 * found.num_inliers - 6, 1)
    # What no pair speaks of stays wide instead of infinite.
    inverse = numpy.linalg.inv(found.H + 1e-6 * numpy.eye(6))
    return (variance * POINTS_PER_INDEPENDENT_ERROR * 0.5 * (inverse + inverse.T))[numpy.ix_(ORDER, ORDER)]


def main() -> int:
    logging.basicConfig(stream=sys.stderr, level=logging.DEBUG, format="%(message)s")
    try:
        with mirador.Graph.from_environment() as graph:
            requests = graph.subscriber("registration_request")
            health = mirador.Health(graph)
            # Whoever publishes answers is there to be asked, so this comes last.
            results = graph.publisher("registration_result")
            health.state(schema.SERVICE_RUNNING)
            for request in requests.listen(idle=health.beat):
                meta = schema.Envelope()
                meta.header.id = request.header.id
                results.send(meta, [answer(request)])
                # Its place is free for the next one.
                del request
    except mirador.GraphError as error:
        # 2: another try with the same program would not help.
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
