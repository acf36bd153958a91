try:
    import small_gicp
except ImportError as error:
    absent(error)

from importlib.metadata import version


def prepare(points, method, voxel_m, neighbours, threads, as_target):
    """Thinned cloud and tree. Whatever the method does not need is left out."""
    cloud = small_gicp.voxelgrid_sampling(points, voxel_m, threads)
    if method == "PLANE_ICP":
        if not as_target:
            return cloud, None
        tree = small_gicp.KdTree(cloud, threads)
        small_gicp.estimate_normals(cloud, tree, neighbours, threads)
    else:
        tree = small_gicp.KdTree(cloud, threads)
        small_gicp.estimate_covariances(cloud, tree, neighbours, threads)
    return cloud, tree


def align(target, source, initial, method, correspondence_m, threads):
    """The wheel's own iteration limit and tolerances."""
    if method == "VGICP":
        voxels = small_gicp.GaussianVoxelMap(1.0)
        voxels.insert(target[0])
        return small_gicp.align(
            voxels, source[0], initial, max_correspondence_distance=correspondence_m, num_threads=threads
        )
    return small_gicp.align(
        target[0],
        source[0],
        target[1],
        initial,
        registration_type=method,
        max_correspondence_distance=correspondence_m,
        num_threads=threads,
    )


def pair(data, method, threads, voxel_m, neighbours, correspondence_m):
    target_points, source_points = clouds(data)
    begin = milliseconds()
    target = prepare(target_points, method, voxel_m, neighbours, threads, True)
    target_ready = milliseconds()
    source = prepare(source_points, method, voxel_m, neighbours, threads, False)
    source_ready = milliseconds()
    result = align(target, source, numpy.eye(4), method, correspondence_m, threads)
    end = milliseconds()
    return {
        "ms": end - begin,
        "parts": {
            "prepare_target": target_ready - begin,
            "prepare_source": source_ready - target_ready,
            "align": end - source_ready,
        },
        "pose": rows(result.T_target_source),
        "iterations": int(result.iterations),
    }


def sequence(data, method, threads, voxel_m, neighbours, correspondence_m, priors):
    """Each scan to the one before it, from the motion between their priors."""
    priors = [numpy.array(prior).reshape(4, 4) for prior in priors]
    each, preparing, aligning, poses, target = [], 0.0, 0.0, [], None
    for k, points in enumerate(clouds(data)):
        begin = milliseconds()
        source = prepare(points, method, voxel_m, neighbours, threads, True)
        ready = milliseconds()
        if target is None:
            pose = priors[k]
        else:
            motion = numpy.linalg.inv(priors[k - 1]) @ priors[k]
            pose = pose @ align(target, source, motion, method, correspondence_m, threads).T_target_source
        target = source
        end = milliseconds()
        each.append(end - begin)
        preparing += ready - begin
        aligning += end - ready
        poses.append(rows(pose))
    return {"ms": each, "parts": {"prepare": preparing, "align": aligning}, "poses": poses}


serve("small_gicp", version("small_gicp"), {"pair": pair, "sequence": sequence})
