"""How mirador's benchmark and a peer talk: one JSON object a line, requests on standard input, answers on standard
output. This text comes first; the text of one peer follows and ends with `serve(name, version, {request: function})`.

    <- {"ready": NAME, "version": VERSION}   or   {"absent": WHY}
    -> {"load": {"data": NAME, "counts": [n, ...]}}, followed by the points: n times x, y, z as little-endian float32
    <- {"loaded": NAME}
    -> {REQUEST: {...}}
    <- an object of results   or   {"error": WHY}
"""

import json
import os
import signal
import sys
import time

# What a library prints must not come between the answers.
_answers = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)
# Ctrl-C ends the whole benchmark, without a traceback for each peer.
signal.signal(signal.SIGINT, signal.SIG_DFL)

_data = {}


def say(answer):
    _answers.write(json.dumps(answer) + "\n")
    _answers.flush()


def absent(why):
    say({"absent": str(why)})
    sys.exit(0)


try:
    import numpy
except ImportError as error:
    absent(error)


def clouds(name):
    """The clouds of a data set: a list of n x 3 arrays of float64, as the peers take them."""
    return _data[name]


def rows(matrix):
    return [float(value) for value in numpy.asarray(matrix).reshape(16)]


def milliseconds():
    return time.perf_counter() * 1e3


def _load(data, counts):
    read = []
    for count in counts:
        block = sys.stdin.buffer.read(count * 12)
        points = numpy.frombuffer(block, dtype="<f4").reshape(-1, 3)
        read.append(numpy.ascontiguousarray(points, dtype=numpy.float64))
    # One data set at a time: the next replaces it.
    _data.clear()
    _data[data] = read
    return {"loaded": data}


def serve(name, version, functions):
    functions = dict(functions, load=_load)
    say({"ready": name, "version": version})
    for line in sys.stdin.buffer:
        try:
            ((request, arguments),) = json.loads(line).items()
            answer = functions[request](**arguments)
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        say(answer)
