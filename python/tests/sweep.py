"""Functions that other processes import."""


def last_positions(experiment):
    return experiment.run().log["tick"]["q"][-1]
