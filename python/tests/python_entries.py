"""A task and a metric in Python, in a module that a pickle can name."""

import numpy as np


class Distance:
    """Distance d of a frame's origin x to a point p, m: with n = (x - p)/d, dd/dt = n · v."""

    elements = [("distance", "m")]

    def __init__(self, parameters, model):
        self.frame = parameters["frame"]
        if self.frame not in model.frames:
            raise KeyError(self.frame)
        self.point = np.array(parameters["point_m"])

    def _direction(self, model):
        away = model.pose(self.frame)[0] - self.point
        return away / np.linalg.norm(away), np.linalg.norm(away)

    def value(self, model):
        return self._direction(model)[1]

    def jacobian(self, model):
        return self._direction(model)[0] @ model.jacobian(self.frame)[:3]

    def bias(self, model):
        n, d = self._direction(model)
        v = model.velocity(self.frame)[:3]
        a = model.bias_acceleration(self.frame)[:3]
        across = v - n * (n @ v)
        return n @ a + across @ across / d


class Position:
    """Position of a frame, m: three elements."""

    elements = [("x", "m"), ("y", "m"), ("z", "m")]

    def __init__(self, parameters, model):
        self.frame = parameters["frame"]

    def value(self, model):
        return model.pose(self.frame)[0]

    def jacobian(self, model):
        return model.jacobian(self.frame)[:3]

    def bias(self, model):
        return model.bias_acceleration(self.frame)[:3]


class Range:
    """Highest minus lowest position of the first joint, rad."""

    better = "smaller"

    def __init__(self):
        self.low, self.high = np.inf, -np.inf

    def add(self, log, settled):
        q = log["tick"]["q"][settled, 0]
        if len(q):
            self.low, self.high = min(self.low, q.min()), max(self.high, q.max())

    def finish(self):
        return float(self.high - self.low) if self.high >= self.low else None
