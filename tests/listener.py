"""An observer that keeps what it is told."""


class Listener:
    def __init__(self):
        self.warnings, self.stages, self.done = [], {}, 0

    def stage(self, name, total):
        self.stages[name] = total
        self.done = 0

    def advance(self, points):
        self.done += points

    def warn(self, message):
        self.warnings.append(message)
