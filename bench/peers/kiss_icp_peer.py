try:
    from kiss_icp.config import load_config
    from kiss_icp.kiss_icp import KissICP
except ImportError as error:
    absent(error)

from importlib.metadata import version


def odometry(data, threads, voxel_m):
    """Scan to local map, without priors. TBB takes its number of threads from the first call in a process."""
    config = load_config(None)
    config.data.deskew = False
    config.mapping.voxel_size = voxel_m
    config.registration.max_num_threads = threads
    pipeline = KissICP(config)
    each, poses = [], []
    for points in clouds(data):
        begin = milliseconds()
        pipeline.register_frame(points, numpy.zeros(0))
        each.append(milliseconds() - begin)
        poses.append(rows(pipeline.last_pose))
    return {"ms": each, "parts": {}, "poses": poses}


serve("kiss_icp", version("kiss_icp"), {"odometry": odometry})
