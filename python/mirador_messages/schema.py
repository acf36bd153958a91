"""Every message, topic and constant of mirador.

Generated from ipc_schema by its test `python_module`; do not edit. A record is what lies in shared memory: its fields are
read in place.
"""

import ctypes

from .topic import Record, Topic


class Header(Record):
    """What the message is about, when, and from whom."""

    TYPE_NAME = "mirador/Header/1"
    SIZE = 48
    _fields_ = [
        # Robot, run and scan, see `ScanId`.
        ("id", ctypes.c_uint64),
        # Time of the sensor (simulated time when simulating) [ns], in the clock `clock_id`.
        ("stamp_ns", ctypes.c_int64),
        # When the work on this message began, CLOCK_MONOTONIC [ns].
        ("began_ns", ctypes.c_uint64),
        # When it was sent, CLOCK_MONOTONIC [ns]; filled in by the publisher.
        ("sent_ns", ctypes.c_uint64),
        # Counts the messages of this publisher from 0; filled in by the publisher.
        ("sequence", ctypes.c_uint64),
        # Which clock `stamp_ns` belongs to: 0 recorded or simulated time, 1 CLOCK_REALTIME.
        ("clock_id", ctypes.c_uint32),
        # How often the service was started in this run: tells a restart from a loss; filled in by the publisher.
        ("incarnation", ctypes.c_uint32),
    ]


class ClockMeta(Record):
    """One step of the clock: what is released, and how far the run has come."""

    TYPE_NAME = "mirador/ClockMeta/1"
    SIZE = 80
    _fields_ = [
        # Names the scan that this step releases.
        ("header", Header),
        # Offset of the stamps' clock to UTC [ns]; 0 while simulating.
        ("utc_offset_ns", ctypes.c_int64),
        # Number of scans the source will deliver, 0 when it cannot know.
        ("scans_expected", ctypes.c_uint32),
        # One of `CLOCK_RUNNING`, `CLOCK_ENDED`, `CLOCK_FAULT`.
        ("state", ctypes.c_uint32),
        # 1 when the next step waits for every service (lockstep), 0 when time releases it.
        ("lockstep", ctypes.c_uint32),
        # Number of scans skipped because their file could not be read.
        ("scans_failed", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint64),
    ]


class Nothing(Record):
    """The item of topics whose meta part says everything."""

    TYPE_NAME = "mirador/Nothing/1"
    SIZE = 8
    _fields_ = [
        # Not used.
        ("reserved", ctypes.c_uint64),
    ]


class Envelope(Record):
    """The meta part of messages that need nothing but the header."""

    TYPE_NAME = "mirador/Envelope/1"
    SIZE = 48
    _fields_ = [
        # The header.
        ("header", Header),
    ]


class ScanRequest(Record):
    """Asks acquisition for scans."""

    TYPE_NAME = "mirador/ScanRequest/1"
    SIZE = 16
    _fields_ = [
        # See `ScanRequestKind`.
        ("kind", ctypes.c_uint32),
        # The scan that is asked for: of a new one the number it is to have. Who is asked to take the scan that was taken last, or is being taken, takes it again.
        ("scan", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint64),
    ]


class LaserSweepMeta(Record):
    """One sweep of the planar laser on the turning head; the items are its `Beam`s."""

    TYPE_NAME = "mirador/LaserSweepMeta/1"
    SIZE = 88
    _fields_ = [
        # Names the scan the sweep belongs to; the stamp is the time of the first beam.
        ("header", Header),
        # Duration of the sweep [ns].
        ("duration_ns", ctypes.c_uint64),
        # Angle of the first beam [rad].
        ("first_angle", ctypes.c_double),
        # Angle between two beams [rad].
        ("angle_step", ctypes.c_double),
        # Counts the sweeps of the device, to tell missing and repeated ones.
        ("sweep", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
        # Longest range of the device [m].
        ("range_max", ctypes.c_double),
    ]


class Beam(Record):
    """One beam of a planar laser."""

    TYPE_NAME = "mirador/Beam/1"
    SIZE = 8
    _fields_ = [
        # Range [m]; NaN where the laser got no return.
        ("range", ctypes.c_float),
        # Sensor's own scale, 0 when unknown.
        ("intensity", ctypes.c_uint16),
        # Time of the beam as a fraction of the sweep, 0 to 65535.
        ("time", ctypes.c_uint16),
    ]


class EncoderReading(Record):
    """One reading of the turning head's encoder."""

    TYPE_NAME = "mirador/EncoderReading/1"
    SIZE = 32
    _fields_ = [
        # Time of the reading, in the header's clock [ns].
        ("stamp_ns", ctypes.c_int64),
        # Angle of the head since the home switch [rad].
        ("angle", ctypes.c_double),
        # Angular velocity [rad/s].
        ("velocity", ctypes.c_double),
        # 1 while the home switch is pressed.
        ("home", ctypes.c_uint32),
        # Counts the readings of the device.
        ("reading", ctypes.c_uint32),
    ]


class PlanarScanMeta(Record):
    """One planar scan of a fixed 2D laser; the items are its `Beam`s."""

    TYPE_NAME = "mirador/PlanarScanMeta/1"
    SIZE = 120
    _fields_ = [
        # The stamp is the time of the first beam.
        ("header", Header),
        # Angle of the first beam, anticlockwise from straight ahead [rad].
        ("first_angle", ctypes.c_double),
        # Angle between two beams [rad].
        ("angle_step", ctypes.c_double),
        # Longest range [m].
        ("range_max", ctypes.c_double),
        # Duration of the sweep [ns].
        ("duration_ns", ctypes.c_uint64),
        # Position of the laser in the robot's frame [m].
        ("mount_xyz", ctypes.c_double * 3),
        # Yaw of the laser in the robot's frame [rad].
        ("mount_yaw", ctypes.c_double),
        # Which of the robot's planar lasers.
        ("sensor", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
    ]


class ScanMeta(Record):
    """The meta part of a scan; the items are its `Point`s."""

    TYPE_NAME = "mirador/ScanMeta/1"
    SIZE = 120
    _fields_ = [
        # Names the scan.
        ("header", Header),
        # The points are relative to this position of the file's own frame [m] (UTM survives f32 this way).
        ("origin", ctypes.c_double * 3),
        # Lines of the grid, 0 for a cloud without order.
        ("rows", ctypes.c_uint32),
        # Points a line, 0 for a cloud without order.
        ("cols", ctypes.c_uint32),
        # Points with a return.
        ("returns", ctypes.c_uint32),
        # Bit mask, see `SCAN_HAS_PRIOR`.
        ("flags", ctypes.c_uint32),
        # Duration of the scan [ns], 0 when unknown.
        ("duration_ns", ctypes.c_uint64),
        # Position of the scan in its source: the file's place in the folder, or the pose's place in the scene.
        ("source_index", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
        # The shortest range that is a return [m]; nearer points were emptied.
        ("range_min_m", ctypes.c_float),
        # The longest range that is a return [m]; farther points were emptied.
        ("range_max_m", ctypes.c_float),
        # Number of returns emptied because of the two limits.
        ("out_of_range", ctypes.c_uint32),
        # Not used.
        ("reserved2", ctypes.c_uint32),
    ]


class Point(Record):
    """One point: position in the scanner's frame [m], NaN where the laser got no return."""

    TYPE_NAME = "mirador/Point/1"
    SIZE = 16
    _fields_ = [
        # Ahead [m].
        ("x", ctypes.c_float),
        # To the left [m].
        ("y", ctypes.c_float),
        # Up [m].
        ("z", ctypes.c_float),
        # Sensor's own scale, 0 when unknown.
        ("intensity", ctypes.c_uint16),
        # Fraction of the scan's duration, 0 to 65535.
        ("time", ctypes.c_uint16),
    ]


class AlignmentMeta(Record):
    """The pose of a scan; the items are the hypotheses that were tried, in order."""

    TYPE_NAME = "mirador/AlignmentMeta/3"
    SIZE = 1288
    _fields_ = [
        # Names the scan.
        ("header", Header),
        # map_from_scanner, row-major 4x4.
        ("map_from_scanner", ctypes.c_double * 16),
        # 6x6 covariance, translation before rotation, perturbation on the right, in the scanner's frame, row-major: the errors of all pairs back to the first scan added up.
        ("covariance", ctypes.c_double * 36),
        # The same of the pose against `target_scan` alone: how well it is known within the map around it. All zero when it was not aligned.
        ("pair_covariance", ctypes.c_double * 36),
        # The prior map_from_scanner, row-major 4x4; only with `has_prior`.
        ("prior", ctypes.c_double * 16),
        # Share of the scan's points with a partner in the target, in [0, 1].
        ("overlap", ctypes.c_double),
        # Root mean square of the final residuals [m].
        ("residual_m", ctypes.c_double),
        # Time the preparation of the scan took [ns].
        ("prepare_ns", ctypes.c_uint64),
        # Time the registration took [ns].
        ("align_ns", ctypes.c_uint64),
        # One of the `ALIGNMENT_*` constants.
        ("status", ctypes.c_uint32),
        # The scan it was aligned to; u32::MAX for none.
        ("target_scan", ctypes.c_uint32),
        # Iterations of the accepted hypothesis.
        ("iterations", ctypes.c_uint32),
        # Bit k is set when the geometry determines the pair's principal direction k, in the order of the Hessian's eigenvalues from the smallest to the largest.
        ("constrained", ctypes.c_uint32),
        # 1 when there was a prior.
        ("has_prior", ctypes.c_uint32),
        # Points of the reduced keyframe.
        ("keyframe_points", ctypes.c_uint32),
        # Bytes of the reduced keyframe with its index.
        ("keyframe_bytes", ctypes.c_uint64),
        # The scanner's motion during the scan, by which its points are to be deskewed: with `start_from_end = exp(m)`, a point seen at the fraction t of the scan is seen from its end at `exp(m)^(t - 1)` times it. Translation [m], then rotation vector [rad], in the moving scanner's frame; zero when the scanner stood, and when its points carry no times. `map_from_scanner` is the pose at the end of the scan then.
        ("scan_motion", ctypes.c_double * 6),
        # 1 when the scan is a node of the map from now on: accepted, and in continuous mode a keyframe.
        ("is_keyframe", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
        # Name of the registration method.
        ("method", ctypes.c_uint8 * 32),
        # Why it was not aligned; empty when it was.
        ("reason", ctypes.c_uint8 * 256),
    ]


class Hypothesis(Record):
    """One hypothesis of an alignment."""

    TYPE_NAME = "mirador/Hypothesis/1"
    SIZE = 480
    _fields_ = [
        # target_from_source at the start, row-major 4x4.
        ("start", ctypes.c_double * 16),
        # target_from_source that was found, row-major 4x4.
        ("found", ctypes.c_double * 16),
        # Share of the scan's points with a partner, in [0, 1].
        ("overlap", ctypes.c_double),
        # Root mean square residual [m].
        ("residual_m", ctypes.c_double),
        # Iterations.
        ("iterations", ctypes.c_uint32),
        # 1 when accepted.
        ("accepted", ctypes.c_uint32),
        # Where the start came from.
        ("origin", ctypes.c_uint8 * 40),
        # Why it was not accepted; empty when it was.
        ("reason", ctypes.c_uint8 * 160),
    ]


class LoopClosingMeta(Record):
    """What alignment did about older scans after this one; the items are the pairs that were tried, in order, then the loops that were switched. Sent once for every scan, after the `pose_corrections` that come of it, if any."""

    TYPE_NAME = "mirador/LoopClosingMeta/1"
    SIZE = 128
    _fields_ = [
        # Names the scan.
        ("header", Header),
        # Weighted squared error of the pairs before the poses were solved for.
        ("chi2_before", ctypes.c_double),
        # And after.
        ("chi2_after", ctypes.c_double),
        # Memory of all keyframes [bytes].
        ("keyframe_bytes", ctypes.c_uint64),
        # Time the whole took [ns].
        ("correction_ns", ctypes.c_uint64),
        # The largest shift of a corrected pose [m].
        ("largest_shift_m", ctypes.c_double),
        # The largest turn of a corrected pose [rad].
        ("largest_turn", ctypes.c_double),
        # Earlier scans within reach that do not directly precede the scan.
        ("candidates", ctypes.c_uint32),
        # Accepted scans so far.
        ("nodes", ctypes.c_uint32),
        # Accepted pairs so far, the sequential ones included.
        ("edges", ctypes.c_uint32),
        # Loops that are switched off.
        ("switched_off", ctypes.c_uint32),
        # Scans whose poses were solved for; 0 when every new pair agreed with the poses as they are.
        ("free_nodes", ctypes.c_uint32),
        # Linearisations.
        ("iterations", ctypes.c_uint32),
        # Poses corrected: items of the `pose_corrections` of this scan.
        ("corrections", ctypes.c_uint32),
        # 1 when the solution converged.
        ("converged", ctypes.c_uint32),
    ]


class ScanPair(Record):
    """A pair of scans that was tried, or switched."""

    TYPE_NAME = "mirador/ScanPair/1"
    SIZE = 512
    _fields_ = [
        # Id of the earlier scan, see `ScanId`.
        ("target_id", ctypes.c_uint64),
        # Id of the later scan.
        ("source_id", ctypes.c_uint64),
        # target_from_source by the poses before, row-major 4x4.
        ("predicted", ctypes.c_double * 16),
        # target_from_source that was found, row-major 4x4.
        ("found", ctypes.c_double * 16),
        # Largest standard deviation of the predicted position [m].
        ("predicted_sigma_m", ctypes.c_double),
        # Largest standard deviation of the predicted angles [rad].
        ("predicted_sigma_rotation", ctypes.c_double),
        # Share of the source that the target should have seen, in [0, 1].
        ("predicted_overlap", ctypes.c_double),
        # Share of the source's points with a partner, in [0, 1].
        ("overlap", ctypes.c_double),
        # Root mean square residual [m].
        ("residual_m", ctypes.c_double),
        # Distance of what was found from what was predicted [standard deviations].
        ("sigmas", ctypes.c_double),
        # Iterations.
        ("iterations", ctypes.c_uint32),
        # One of `PAIR_OVERLAP`, `PAIR_LOOP`.
        ("kind", ctypes.c_uint32),
        # One of `PAIR_ACCEPTED`, `PAIR_REJECTED`, `PAIR_SWITCHED_OFF`, `PAIR_SWITCHED_ON`.
        ("status", ctypes.c_uint32),
        # 1 when registration began at what coarse alignment had found.
        ("is_coarse", ctypes.c_uint32),
        # Why it was not accepted; empty when it was.
        ("reason", ctypes.c_uint8 * 176),
    ]


class PoseCorrection(Record):
    """A correction of an older scan's pose."""

    TYPE_NAME = "mirador/PoseCorrection/1"
    SIZE = 424
    _fields_ = [
        # Id of the scan, see `ScanId`.
        ("id", ctypes.c_uint64),
        # The new map_from_scanner, row-major 4x4.
        ("map_from_scanner", ctypes.c_double * 16),
        # Its 6x6 covariance, as in `AlignmentMeta`.
        ("covariance", ctypes.c_double * 36),
    ]


class RegistrationRequestMeta(Record):
    """Asks a foreign process to register two keyframes; the items are the target's points, then the source's."""

    TYPE_NAME = "mirador/RegistrationRequestMeta/1"
    SIZE = 232
    _fields_ = [
        # Names the source scan.
        ("header", Header),
        # Id of the target scan; u64::MAX where nobody has said which it is.
        ("target_id", ctypes.c_uint64),
        # target_from_source to start from, row-major 4x4.
        ("initial_target_from_source", ctypes.c_double * 16),
        # Pairs farther apart than this do not count [m].
        ("pair_distance_m", ctypes.c_double),
        # The result may not move farther than this from the start [m].
        ("max_translation_m", ctypes.c_double),
        # The result may not turn farther than this from the start [rad].
        ("max_rotation", ctypes.c_double),
        # Number of points of the target, the first items.
        ("target_points", ctypes.c_uint32),
        # Number of points of the source, the items behind them.
        ("source_points", ctypes.c_uint32),
        # Most iterations.
        ("max_iterations", ctypes.c_uint32),
        # The answer is worthless after this time [ms].
        ("timeout_ms", ctypes.c_uint32),
        # Numbers the requests; the result repeats it.
        ("request", ctypes.c_uint64),
    ]


class KeyframePoint(Record):
    """One point of a reduced keyframe with its normal, in its scanner's frame."""

    TYPE_NAME = "mirador/KeyframePoint/1"
    SIZE = 32
    _fields_ = [
        # Position [m]; the fourth value is 1, so that the item is a homogeneous point.
        ("position", ctypes.c_float * 4),
        # Unit normal; the fourth value is 0.
        ("normal", ctypes.c_float * 4),
    ]


class RegistrationResult(Record):
    """The answer to a registration request."""

    TYPE_NAME = "mirador/RegistrationResult/2"
    SIZE = 456
    _fields_ = [
        # The request this answers.
        ("request", ctypes.c_uint64),
        # target_from_source, row-major 4x4.
        ("target_from_source", ctypes.c_double * 16),
        # Its 6x6 covariance, as in `AlignmentMeta`.
        ("covariance", ctypes.c_double * 36),
        # Share of the source's points with a partner, in [0, 1].
        ("overlap", ctypes.c_double),
        # Root mean square residual [m].
        ("residual_m", ctypes.c_double),
        # Iterations.
        ("iterations", ctypes.c_uint32),
        # 1 when converged.
        ("converged", ctypes.c_uint32),
        # As in `AlignmentMeta`. Only reported: alignment finds out by itself.
        ("constrained", ctypes.c_uint32),
        # The schema that the answering process was built with: the lower halves of the schema hashes of `registration_request` and `registration_result`, combined by exclusive or.
        ("schema", ctypes.c_uint32),
    ]


class RegistrationStatus(Record):
    """How a foreign registration is doing, over the whole run."""

    TYPE_NAME = "mirador/RegistrationStatus/1"
    SIZE = 440
    _fields_ = [
        # Name of the built-in method that takes its place.
        ("fallback", ctypes.c_uint8 * 32),
        # Alignments that were to be made.
        ("questions", ctypes.c_uint64),
        # Of these, those by an answer.
        ("answered", ctypes.c_uint64),
        # Of these, those by the built-in method.
        ("fallbacks", ctypes.c_uint64),
        # Of those by the built-in method, how many for which reason; the places are the `REGISTRATION_*` constants.
        ("faults", ctypes.c_uint64 * 13),
        # From request to answer, the last one [ns].
        ("last_answer_ns", ctypes.c_uint64),
        # From request to answer, all together [ns].
        ("total_answer_ns", ctypes.c_uint64),
        # From request to answer, the longest [ns].
        ("max_answer_ns", ctypes.c_uint64),
        # The last fault in words; empty while there was none.
        ("last_fault", ctypes.c_uint8 * 256),
    ]


class ScoredScanMeta(Record):
    """The meta part of a scored scan; the items are one `PointScore` per point of the scan."""

    TYPE_NAME = "mirador/ScoredScanMeta/1"
    SIZE = 168
    _fields_ = [
        # Names the scan.
        ("header", Header),
        # When the scan was sent, CLOCK_MONOTONIC [ns].
        ("scan_sent_ns", ctypes.c_uint64),
        # When its alignment was sent, CLOCK_MONOTONIC [ns].
        ("alignment_sent_ns", ctypes.c_uint64),
        # Time the surface (mesh, normals, areas, quality) took [ns].
        ("surface_ns", ctypes.c_uint64),
        # Time the scores took, after the alignment was there [ns].
        ("analysis_ns", ctypes.c_uint64),
        # Height of the ground under the robot in the level frame, that is relative to the scanner [m].
        ("ground_height_m", ctypes.c_double),
        # Mean quality of the valid points, in [0, 1].
        ("mean_quality", ctypes.c_double),
        # Triangles in the mesh.
        ("triangles_kept", ctypes.c_uint32),
        # Triangles discarded because they span two surfaces.
        ("triangles_discarded", ctypes.c_uint32),
        # Points with a normal.
        ("points_valid", ctypes.c_uint32),
        # Points the robot could reach.
        ("points_reachable", ctypes.c_uint32),
        # 1 when the ground height was estimated from the scan, 0 when it was given, 2 when neither and a default holds.
        ("ground_source", ctypes.c_uint32),
        # Status of the alignment, one of the `ALIGNMENT_*` constants.
        ("alignment_status", ctypes.c_uint32),
        # Position of the scanner in the map [m].
        ("scanner_position", ctypes.c_double * 3),
        # Zones of interest found.
        ("zones", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
        # Not used.
        ("reserved2", ctypes.c_uint64 * 2),
    ]


class PointScore(Record):
    """The scores of one point, under the same index as in the scan."""

    TYPE_NAME = "mirador/PointScore/1"
    SIZE = 16
    _fields_ = [
        # F, navigable surface.
        ("navigable", ctypes.c_uint16),
        # B, obstacle.
        ("obstacle", ctypes.c_uint16),
        # D, quality.
        ("quality", ctypes.c_uint16),
        # Bit 0 valid, bit 1 reachable, bit 2 the normal's z is negative, bits 4 to 7: the triangle of this cell's quad (this cell, next in the row, next row, next row and next) that leaves out corner 0 to 3 is in the mesh.
        ("flags", ctypes.c_uint16),
        # Unit normal in the scanner's frame: x and y times 32767.
        ("normal_xy", ctypes.c_int16 * 2),
        # The point's share of the surface [m^2].
        ("area", ctypes.c_float),
    ]


class Zone(Record):
    """An occluded plane worth another look."""

    TYPE_NAME = "mirador/Zone/1"
    SIZE = 40
    _fields_ = [
        # Centre in the map [m].
        ("centre", ctypes.c_float * 3),
        # Normal in the map, its length is the area [m^2].
        ("normal", ctypes.c_float * 3),
        # Area [m^2].
        ("area", ctypes.c_float),
        # Discarded triangles in it.
        ("triangles", ctypes.c_uint32),
        # The scan of the run it was seen in last.
        ("scan", ctypes.c_uint32),
        # 1 when merged with a zone of an earlier scan.
        ("merged", ctypes.c_uint32),
    ]


class MapMeta(Record):
    """The meta part of an information map message; the items are the tiles that changed."""

    TYPE_NAME = "mirador/MapMeta/2"
    SIZE = 104
    _fields_ = [
        # Names the scan after which the tiles hold.
        ("header", Header),
        # Counts the updates of the map.
        ("revision", ctypes.c_uint64),
        # Side of a cell [m].
        ("cell_m", ctypes.c_double),
        # Tiles of the whole map.
        ("tiles_total", ctypes.c_uint32),
        # Known cells of the whole map.
        ("cells_known", ctypes.c_uint32),
        # Mean quality of the known cells, in [0, 1].
        ("mean_quality", ctypes.c_double),
        # Bytes the map takes in memory.
        ("bytes", ctypes.c_uint64),
        # This message of the update, counted from 0.
        ("part", ctypes.c_uint32),
        # Messages of the update.
        ("parts", ctypes.c_uint32),
        # One of the `MAP_CAUSE_*` constants.
        ("cause", ctypes.c_uint32),
        # Scans that were moved since the update before.
        ("moved_scans", ctypes.c_uint32),
    ]


class MapCell(Record):
    """One level of a cell of the information map."""

    TYPE_NAME = "mirador/MapCell/2"
    SIZE = 32
    _fields_ = [
        # Mean height of everything seen of it [m, map]; NaN when unknown.
        ("height", ctypes.c_float),
        # Mean height of its ground [m, map]; NaN without ground to drive on.
        ("ground", ctypes.c_float),
        # Free height over it to what hangs there or to the next level [m]; infinite under the open sky.
        ("clearance", ctypes.c_float),
        # C_nc, navigability; only with evidence.
        ("navigability", ctypes.c_uint16),
        # Q_a, mean quality; only with evidence.
        ("quality", ctypes.c_uint16),
        # Mean F over the navigable points.
        ("navigable_mean", ctypes.c_uint16),
        # Mean B over the obstacle points.
        ("obstacle_mean", ctypes.c_uint16),
        # Points measured.
        ("measured", ctypes.c_uint32),
        # Triangles that cover its middle.
        ("interpolated", ctypes.c_uint32),
        # Bit 0: known (any evidence at all).
        ("flags", ctypes.c_uint32),
    ]


class MapTile(Record):
    """One level of a square of the information map: cell (column, row) of the tile has index `row * 16 + column`. A tile is always sent with all its levels; readers drop those from `levels` on, which it had before."""

    TYPE_NAME = "mirador/MapTile/2"
    SIZE = 8208
    _fields_ = [
        # Column of the tile; its first cell begins at `tile_x * 16 * cell size` in the map.
        ("tile_x", ctypes.c_int32),
        # Row of the tile.
        ("tile_y", ctypes.c_int32),
        # Which level of the cells, counted from the lowest of each: 1 is the deck where 0 is the road under it.
        ("level", ctypes.c_uint32),
        # Number of levels of the tile; 1 unless something can be passed both under and over.
        ("levels", ctypes.c_uint32),
        # The cells.
        ("cells", MapCell * 256),
    ]


class ViewPlanMeta(Record):
    """A view plan: the decision; the items are the candidates with their terms."""

    TYPE_NAME = "mirador/ViewPlanMeta/1"
    SIZE = 496
    _fields_ = [
        # Names the newest scan the plan knows of.
        ("header", Header),
        # When that scan was sent, CLOCK_MONOTONIC [ns].
        ("scan_sent_ns", ctypes.c_uint64),
        # Time the map update took [ns].
        ("map_ns", ctypes.c_uint64),
        # Time the planning took [ns].
        ("planning_ns", ctypes.c_uint64),
        # Revision of the map it was taken on.
        ("map_revision", ctypes.c_uint64),
        # map_from_scanner it was taken at, row-major 4x4.
        ("map_from_scanner", ctypes.c_double * 16),
        # Weights A, Q, O, C.
        ("weights", ctypes.c_double * 4),
        # C_p: below this utility the model is good enough.
        ("utility_threshold", ctypes.c_double),
        # Mean quality of the known cells, in [0, 1].
        ("mean_quality", ctypes.c_double),
        # Mean quality asked for, in [0, 1].
        ("quality_asked", ctypes.c_double),
        # Known cells of the map.
        ("cells_known", ctypes.c_uint32),
        # Navigable cells of the map.
        ("cells_navigable", ctypes.c_uint32),
        # `DECISION_GO` or `DECISION_STOP`.
        ("decision", ctypes.c_uint32),
        # Index of the chosen candidate; u32::MAX for none.
        ("chosen", ctypes.c_uint32),
        # Zones of interest known.
        ("zones", ctypes.c_uint32),
        # Tiles of the map.
        ("map_tiles", ctypes.c_uint32),
        # Length of the path [m].
        ("path_length_m", ctypes.c_double),
        # Bytes the map takes in memory.
        ("map_bytes", ctypes.c_uint64),
        # Name of the strategy.
        ("strategy", ctypes.c_uint8 * 32),
        # The typed reason of the decision, a short name such as `best_utility`, `done`, `nothing_reachable`.
        ("reason_code", ctypes.c_uint8 * 32),
        # The reason of the decision in words.
        ("reason", ctypes.c_uint8 * 128),
    ]


class CandidateView(Record):
    """One candidate view."""

    TYPE_NAME = "mirador/CandidateView/1"
    SIZE = 144
    _fields_ = [
        # Position in the map [m].
        ("position", ctypes.c_double * 3),
        # Direction the robot arrives in [rad].
        ("heading", ctypes.c_double),
        # A: information gain in [0, 1].
        ("information", ctypes.c_double),
        # Q: quality gain in [0, 1].
        ("quality", ctypes.c_double),
        # O: zones of interest in [0, 1].
        ("zones", ctypes.c_double),
        # C: travel cost [m, weighted by navigability].
        ("cost", ctypes.c_double),
        # u: utility.
        ("utility", ctypes.c_double),
        # Unexplored cells that would be seen.
        ("unexplored_cells", ctypes.c_uint32),
        # `CANDIDATE_OPEN` or the code of the rejection.
        ("status", ctypes.c_uint32),
        # The rejection in words; empty when valued.
        ("reason", ctypes.c_uint8 * 64),
    ]


class PathMeta(Record):
    """The path to the chosen view; the items are its `Waypoint`s from the robot on."""

    TYPE_NAME = "mirador/PathMeta/1"
    SIZE = 72
    _fields_ = [
        # Names the scan whose view plan this belongs to.
        ("header", Header),
        # Revision of the map it was planned on.
        ("map_revision", ctypes.c_uint64),
        # Length [m].
        ("length_m", ctypes.c_double),
        # Travel cost [m, weighted by navigability].
        ("cost", ctypes.c_double),
    ]


class Waypoint(Record):
    """One point of a path in the map."""

    TYPE_NAME = "mirador/Waypoint/1"
    SIZE = 32
    _fields_ = [
        # Position [m].
        ("position", ctypes.c_double * 3),
        # Navigability of its cell, in [0, 1].
        ("navigability", ctypes.c_double),
    ]


class ReplanRequest(Record):
    """Asks planning to decide again on the map it has."""

    TYPE_NAME = "mirador/ReplanRequest/1"
    SIZE = 80
    _fields_ = [
        # Weights A, Q, O, C; NaN keeps the configured one.
        ("weights", ctypes.c_double * 4),
        # Why: 0 asked by a user, 1 target given up by navigation, 2 pose corrected.
        ("cause", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
        # Name of the strategy; empty keeps the configured one.
        ("strategy", ctypes.c_uint8 * 40),
    ]


class Odometry(Record):
    """Wheel odometry."""

    TYPE_NAME = "mirador/Odometry/1"
    SIZE = 88
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # odom_from_robot: x, y, z [m].
        ("position", ctypes.c_double * 3),
        # odom_from_robot: quaternion x, y, z, w.
        ("orientation", ctypes.c_double * 4),
        # Forward speed [m/s].
        ("linear", ctypes.c_double),
        # Turning speed about z [rad/s].
        ("angular", ctypes.c_double),
        # Distance driven since the start [m].
        ("distance", ctypes.c_double),
    ]


class Imu(Record):
    """Inertial measurement in the robot's frame."""

    TYPE_NAME = "mirador/Imu/1"
    SIZE = 80
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # Acceleration including gravity [m/s^2].
        ("acceleration", ctypes.c_double * 3),
        # Angular velocity [rad/s].
        ("angular_velocity", ctypes.c_double * 3),
        # Standard deviation of one acceleration component [m/s^2].
        ("acceleration_sigma", ctypes.c_double),
        # Standard deviation of one angular velocity component [rad/s].
        ("angular_velocity_sigma", ctypes.c_double),
        # Temperature [K], 0 when unknown.
        ("temperature", ctypes.c_double),
    ]


class Gnss(Record):
    """Satellite position."""

    TYPE_NAME = "mirador/Gnss/1"
    SIZE = 88
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # Latitude [rad].
        ("latitude", ctypes.c_double),
        # Longitude [rad].
        ("longitude", ctypes.c_double),
        # Height over the ellipsoid [m].
        ("height", ctypes.c_double),
        # Velocity east, north, up [m/s].
        ("velocity", ctypes.c_double * 3),
        # Standard deviation east, north, up [m].
        ("sigma", ctypes.c_double * 3),
        # 0 none, 1 single, 2 differential, 3 real-time kinematic.
        ("fix", ctypes.c_uint32),
        # Satellites used.
        ("satellites", ctypes.c_uint32),
    ]


class Magnetometer(Record):
    """Magnetic field in the robot's frame."""

    TYPE_NAME = "mirador/Magnetometer/1"
    SIZE = 40
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # Field [T].
        ("field", ctypes.c_double * 3),
        # Standard deviation of one component [T].
        ("sigma", ctypes.c_double),
    ]


class Ranger(Record):
    """One ultrasonic ranger."""

    TYPE_NAME = "mirador/Ranger/1"
    SIZE = 64
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # Position of the ranger in the robot's frame [m].
        ("mount_xyz", ctypes.c_double * 3),
        # Direction of the ranger: yaw and pitch in the robot's frame [rad].
        ("mount_yaw_pitch", ctypes.c_double * 2),
        # Opening angle of the cone [rad].
        ("aperture", ctypes.c_double),
        # Range [m], NaN where nothing was heard.
        ("range", ctypes.c_float),
        # Which ranger.
        ("sensor", ctypes.c_uint32),
    ]


class Battery(Record):
    """Battery state."""

    TYPE_NAME = "mirador/Battery/1"
    SIZE = 40
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # Voltage [V].
        ("voltage", ctypes.c_double),
        # Current drawn [A].
        ("current", ctypes.c_double),
        # Charge left in [0, 1].
        ("charge", ctypes.c_double),
        # 1 when so low that the robot must stop.
        ("low", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
    ]


class RobotPose(Record):
    """Where localisation takes the robot to be now."""

    TYPE_NAME = "mirador/RobotPose/1"
    SIZE = 440
    _fields_ = [
        # map_from_robot, row-major 4x4.
        ("map_from_robot", ctypes.c_double * 16),
        # Its 6x6 covariance, translation before rotation, perturbation on the right, in the robot's frame, row-major.
        ("covariance", ctypes.c_double * 36),
        # Forward speed [m/s].
        ("linear", ctypes.c_double),
        # Turning speed about z [rad/s].
        ("angular", ctypes.c_double),
        # 1 while localisation does not know where it is.
        ("lost", ctypes.c_uint32),
        # Number of the newest scan whose alignment is in the estimate; u32::MAX for none.
        ("aligned_scan", ctypes.c_uint32),
    ]


class PoseEstimate(Record):
    """An estimate of the scanner's pose in a scan: from localisation, or recorded beside the scans."""

    TYPE_NAME = "mirador/PoseEstimate/1"
    SIZE = 432
    _fields_ = [
        # map_from_scanner, row-major 4x4.
        ("map_from_scanner", ctypes.c_double * 16),
        # Its 6x6 covariance, translation before rotation, perturbation on the right, in the scanner's frame, row-major; all zero when unknown.
        ("covariance", ctypes.c_double * 36),
        # Who says it: 0 recorded, in any fixed frame, `POSE_FROM_LOCALIZATION` in the map as alignment has it, 2 constant motion.
        ("source", ctypes.c_uint32),
        # 1 while localisation does not know where it is.
        ("lost", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint64),
    ]


class MotionCommand(Record):
    """A reference for the drives."""

    TYPE_NAME = "mirador/MotionCommand/1"
    SIZE = 40
    _fields_ = [
        # Time [ns].
        ("stamp_ns", ctypes.c_int64),
        # Forward speed [m/s].
        ("linear", ctypes.c_double),
        # Turning speed about z [rad/s].
        ("angular", ctypes.c_double),
        # The command ends after this time [ns]; 0 signs its source off. Of an emergency stop 0 releases it and anything else presses it.
        ("valid_ns", ctypes.c_uint64),
        # Source by priority: 0 emergency stop, 1 board joystick, 2 radio, 3 operator, 4 navigation.
        ("source", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
    ]


class NavigationStatus(Record):
    """What navigation does with the path it was given."""

    TYPE_NAME = "mirador/NavigationStatus/1"
    SIZE = 136
    _fields_ = [
        # 0 idle, 1 driving, 2 arrived, 3 blocked, 4 recovering, 5 gave up.
        ("state", ctypes.c_uint32),
        # Index of the waypoint it drives to.
        ("waypoint", ctypes.c_uint32),
        # Distance driven on this path [m].
        ("driven_m", ctypes.c_double),
        # Distance left [m].
        ("left_m", ctypes.c_double),
        # Scan whose plan the path belongs to, see `ScanId`.
        ("plan_id", ctypes.c_uint64),
        # Why, in words.
        ("reason", ctypes.c_uint8 * 104),
    ]


class Obstruction(Record):
    """Where something held the robot that the map shows nothing of: told before the scan that is taken there."""

    TYPE_NAME = "mirador/Obstruction/1"
    SIZE = 32
    _fields_ = [
        # Centre of a disc that the robot cannot get into [m, map frame].
        ("centre", ctypes.c_double * 2),
        # Its radius [m].
        ("radius", ctypes.c_double),
        # Number of the scan after which it happened.
        ("scan", ctypes.c_uint32),
        # Not used.
        ("reserved", ctypes.c_uint32),
    ]


class RobotState(Record):
    """The state of the robot as a whole: the last message of a control step, when all that its sensors have said up to the stamp is sent."""

    TYPE_NAME = "mirador/RobotState/2"
    SIZE = 152
    _fields_ = [
        # map_from_robot, row-major 4x4: of a simulated robot the truth, for the record, by which nobody steers; all zero where nobody knows it.
        ("map_from_robot", ctypes.c_double * 16),
        # Forward speed [m/s].
        ("linear", ctypes.c_double),
        # 1 while the emergency stop is pressed.
        ("emergency_stop", ctypes.c_uint32),
        # 1 when tipped over.
        ("tipped", ctypes.c_uint32),
        # 1 while the head turns for a scan.
        ("scanning", ctypes.c_uint32),
        # Number of scans the head has turned for.
        ("scans", ctypes.c_uint32),
    ]


class WorkSpan(Record):
    """A piece of work on a scan: what it waited for and how long it took, all times CLOCK_MONOTONIC [ns]."""

    TYPE_NAME = "mirador/WorkSpan/1"
    SIZE = 64
    _fields_ = [
        # What was done, for example `surface`.
        ("stage", ctypes.c_uint8 * 16),
        # The scan.
        ("scan", ctypes.c_uint32),
        # The thread: 0 the main one, 1 that which takes scans in.
        ("thread", ctypes.c_uint32),
        # When the last of what it needs was sent or made; 0 when it needs nothing.
        ("input_ns", ctypes.c_uint64),
        # Since when the thread slept before it.
        ("asleep_ns", ctypes.c_uint64),
        # When that sleep ended.
        ("woke_ns", ctypes.c_uint64),
        # When the work began.
        ("began_ns", ctypes.c_uint64),
        # When it was done, its result sent.
        ("ended_ns", ctypes.c_uint64),
    ]


class ServiceHealth(Record):
    """Health and progress of one service; also its acknowledgement in lockstep."""

    TYPE_NAME = "mirador/ServiceHealth/2"
    SIZE = 856
    _fields_ = [
        # Name of the service.
        ("service", ctypes.c_uint8 * 32),
        # Process id.
        ("pid", ctypes.c_uint32),
        # One of the `SERVICE_*` constants.
        ("state", ctypes.c_uint32),
        # Number of scans finished, counted from the first of the run: every scan below it is done.
        ("finished_scans", ctypes.c_uint32),
        # How many of `spans` are told.
        ("span_count", ctypes.c_uint32),
        # Resident memory [bytes].
        ("resident_bytes", ctypes.c_uint64),
        # CPU time of the process [ns].
        ("cpu_ns", ctypes.c_uint64),
        # Payload bytes this service copied out of or into shared memory through its ports.
        ("copied_payload_bytes", ctypes.c_uint64),
        # Messages seen to be missing (gaps in sequence numbers).
        ("lost_messages", ctypes.c_uint64),
        # Messages that could not be delivered within the back-pressure limit.
        ("undelivered_messages", ctypes.c_uint64),
        # Messages sent.
        ("sent_messages", ctypes.c_uint64),
        # Messages received.
        ("received_messages", ctypes.c_uint64),
        # Time of the last unit of work [ns].
        ("last_work_ns", ctypes.c_uint64),
        # Page faults that needed no disk.
        ("minor_faults", ctypes.c_uint64),
        # Page faults that had to wait for a disk.
        ("major_faults", ctypes.c_uint64),
        # Times the service gave up the processor to wait.
        ("voluntary_switches", ctypes.c_uint64),
        # Times the processor was taken from it.
        ("involuntary_switches", ctypes.c_uint64),
        # What it is doing, or why it failed.
        ("message", ctypes.c_uint8 * 200),
        # Its work since the last scan it reported as finished; told once, with that of the next.
        ("spans", WorkSpan * 8),
    ]


TOPICS = {
    topic.name: topic
    for topic in [
        Topic("clock", ClockMeta, Nothing, "a692f6c8c6111163", "wait", 1),
        Topic("scan_request", Envelope, ScanRequest, "428329bfcc59ed1f", "wait", 16),
        Topic("laser_sweep", LaserSweepMeta, Beam, "7972e9481bad5e22", "wait", 2048),
        Topic("encoder", Envelope, EncoderReading, "8ffbcc326986a372", "wait", 64),
        Topic("planar_scan", PlanarScanMeta, Beam, "a8b017738789f63a", "drop", 2048),
        Topic("scan", ScanMeta, Point, "4f88ee0966273c2e", "wait", "scan"),
        Topic("alignment", AlignmentMeta, Hypothesis, "5a9079e378f3346f", "wait", 16),
        Topic("loop_closing", LoopClosingMeta, ScanPair, "1ed9083f7f8a800d", "wait", 64),
        Topic("pose_corrections", Envelope, PoseCorrection, "c1fffbdae29decf8", "wait", 1024),
        Topic("registration_request", RegistrationRequestMeta, KeyframePoint, "0ab0024ac10d1c28", "drop", "keyframes"),
        Topic("registration_result", Envelope, RegistrationResult, "40c1472a1e038ccd", "drop", 1),
        Topic("registration_status", Envelope, RegistrationStatus, "3ea761b5d00615ec", "supersede", 1),
        Topic("scored_scan", ScoredScanMeta, PointScore, "d97dca253dce56f3", "wait", "scan"),
        Topic("zones", Envelope, Zone, "475aa63b6caad5fd", "wait", 4096),
        Topic("information_map", MapMeta, MapTile, "812b4361655e6010", "wait", 192),
        Topic("view_plan", ViewPlanMeta, CandidateView, "3861fec07ee016fa", "wait", 4096),
        Topic("path", PathMeta, Waypoint, "d90be58b2a5b836b", "wait", 4096),
        Topic("replan_request", Envelope, ReplanRequest, "6999ffca1974fa76", "wait", 1),
        Topic("odometry", Envelope, Odometry, "3d80a7d8ede0c94d", "drop", 64),
        Topic("imu", Envelope, Imu, "411a59a19dd6dd7c", "drop", 64),
        Topic("gnss", Envelope, Gnss, "43f8b49b239893e7", "drop", 16),
        Topic("magnetometer", Envelope, Magnetometer, "55c74d7073a4a466", "drop", 64),
        Topic("rangers", Envelope, Ranger, "bb8f7a0ecc599136", "drop", 32),
        Topic("battery", Envelope, Battery, "19fde79733553ef1", "drop", 1),
        Topic("robot_pose", Envelope, RobotPose, "958b701808646106", "drop", 1),
        Topic("pose", Envelope, PoseEstimate, "bff082ad8dd47225", "drop", 1),
        Topic("motion_command", Envelope, MotionCommand, "c5afa13805077eec", "drop", 1),
        Topic("navigation_status", Envelope, NavigationStatus, "4159a62cb7c7ce6b", "drop", 1),
        Topic("obstructions", Envelope, Obstruction, "baca12d5f2658e58", "wait", 1),
        Topic("robot_state", Envelope, RobotState, "3ccceb3749f1ab60", "drop", 1),
        Topic("service_health", Envelope, ServiceHealth, "1a7cbb70588c7fe6", "supersede", 1),
    ]
}

# What an answer to a registration request says it was made with.
ANSWER_SCHEMA = 0xdf0e90e5

# Scans are being released.
CLOCK_RUNNING = 0
# The last scan was released and finished by every service.
CLOCK_ENDED = 1
# The source cannot go on; the reason is in its service health.
CLOCK_FAULT = 2
# A `pose` message with the same id was sent before this scan: the prior of its alignment.
SCAN_HAS_PRIOR = 1
# Take a new scan here.
SCAN_REQUEST_TAKE = 0
# Send the named scan of this run once more; who has finished it ignores it.
SCAN_REQUEST_RESEND = 1
# The pose is localisation's, which hears where scans were aligned: it is in the map.
POSE_FROM_LOCALIZATION = 1
# The first scan: it defines the map.
ALIGNMENT_FIRST = 0
# Aligned to an earlier scan.
ALIGNMENT_ACCEPTED = 1
# Not aligned; the pose is the guess, and `reason` says why.
ALIGNMENT_REJECTED = 2
# A pair was accepted.
PAIR_ACCEPTED = 0
# A pair was tried and rejected; `reason` says why.
PAIR_REJECTED = 1
# A loop accepted earlier is switched off from now on, since it contradicts the rest.
PAIR_SWITCHED_OFF = 2
# A loop that was switched off counts again.
PAIR_SWITCHED_ON = 3
# The scans overlap because they were taken shortly after one another.
PAIR_OVERLAP = 0
# The robot was here before.
PAIR_LOOP = 1
# Nobody answers: the process is not there, or has ended.
REGISTRATION_ABSENT = 0
# The process ended while it was asked.
REGISTRATION_DIED = 1
# No answer came in time.
REGISTRATION_LATE = 2
# The answer was to an older request, or to one that was never made.
REGISTRATION_OUTDATED = 3
# The pose or what goes with it holds a value that is not finite.
REGISTRATION_NOT_FINITE = 4
# The pose is not a rigid motion.
REGISTRATION_NOT_RIGID = 5
# The covariance is not symmetric and positive definite.
REGISTRATION_COVARIANCE = 6
# The pose lies outside the limits of the request.
REGISTRATION_OUTSIDE = 7
# The scans fit worse at the pose than at the start, or the built-in method found what the answer had missed.
REGISTRATION_WRONG = 8
# Far more answers came than were asked for.
REGISTRATION_FLOOD = 9
# The answer was made by another version of the messages.
REGISTRATION_SCHEMA = 10
# The request could not be sent.
REGISTRATION_NOT_SENT = 11
# It was not asked, since it had failed several times in a row.
REGISTRATION_PAUSED = 12
# Value of `Zone::merged` for a zone that was seen from more than one scan.
ZONE_MERGED = 1
# Cells along the side of a `MapTile`.
MAP_TILE_SIDE = 16
# Cells of a `MapTile`.
MAP_TILE_CELLS = MAP_TILE_SIDE * MAP_TILE_SIDE
# The map has changed because of the scan that the header names.
MAP_CAUSE_SCAN = 0
# Poses were corrected after that scan.
MAP_CAUSE_CORRECTION = 1
# Nothing has changed: the whole map is said again after a restart.
MAP_CAUSE_RESTART = 2
# The plan goes to the chosen candidate.
DECISION_GO = 0
# The plan stops; `reason` says why.
DECISION_STOP = 1
# Status of a candidate that was valued; anything else is the code of its rejection, in words in `reason`.
CANDIDATE_OPEN = 0
# Ports are being opened.
SERVICE_STARTING = 0
# Working.
SERVICE_RUNNING = 1
# Finishing what it has.
SERVICE_STOPPING = 2
# It cannot go on; `message` says why.
SERVICE_FAILED = 3
# The most pieces of work that one report tells of.
MAX_WORK_SPANS = 8
