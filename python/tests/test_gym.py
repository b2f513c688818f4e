"""Environments of Gymnasium: the checker's rules, equal seeds, the same policy on both kinds of robot."""

import gymnasium
import numpy as np
import opspace.gym
import pytest
from gymnasium.utils.env_checker import check_env
from test_loops import REACH, streamed

def make(**options):
    return gymnasium.make(
        "opspace/Task-v0",
        task={**REACH, "duration_s": 60.0},
        robot=opspace.robots()["panda"],
        **{"target": "hand", "frame": "flange", "backend": "position", "duration_s": 2.0, **options},
    )


@pytest.mark.parametrize("action", opspace.gym.ACTIONS)
@pytest.mark.filterwarnings("ignore:.*Box observation space.*:UserWarning")
def test_checker_finds_nothing(action):
    check_env(make(action=action).unwrapped, skip_render_check=True)


def test_same_seed_gives_the_same_bits():
    env = make()
    episodes = []
    for _ in range(2):
        seen = [env.reset(seed=7)[0]]
        env.action_space.seed(1)
        for _ in range(5):
            seen.append(env.step(env.action_space.sample())[0])
        episodes.append(np.concatenate(seen).tobytes())
    assert episodes[0] == episodes[1]


def test_one_policy_moves_a_position_robot_as_a_torque_robot():
    ends = {}
    for backend in ("position", "torque"):
        env = make(backend=backend, action="twist", speed_scale_m_per_s=0.1, duration_s=20.0)
        env.reset(seed=1)
        task = env.unwrapped
        for _ in range(25):
            _, reward, terminated, _, info = env.step(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
            assert not terminated and info == {} and reward == 0.0
        model = task._experiment.model
        model.update(task._simulation.q)
        ends[backend] = model.pose("flange")[0]
    assert streamed().joints[0] == "joint1"
    assert np.abs(ends["position"] - ends["torque"]).max() < 2e-3


def test_vectors_of_environments():
    envs = gymnasium.vector.SyncVectorEnv([make for _ in range(3)])
    observation, _ = envs.reset(seed=3)
    observation, reward, *_ = envs.step(envs.action_space.sample())
    assert observation.shape == (3, 14) and reward.shape == (3,)


def test_episodes_differ_and_environments_too():
    def begin(env, seed=None):
        env.reset(seed=seed)
        return env.step(np.zeros(6))[0]

    env, other = make(), make()
    first = [begin(env, 3), begin(env)]
    assert not np.array_equal(first[0], first[1])
    assert np.array_equal(first, [begin(env, 3), begin(env)])
    assert not np.array_equal(begin(env), begin(other))


def test_mistakes_are_named_at_once():
    with pytest.raises(ValueError, match="no frame 'nose'"):
        make(frame="nose")
    with pytest.raises(ValueError, match="no task 'arm' with inputs"):
        make(target="arm")
    with pytest.raises(ValueError, match="render_mode"):
        opspace.gym.TaskEnv(REACH, "hand", "flange", opspace.robots()["panda"], render_mode="human")
    env = make(reward=lambda signals: -1.0).unwrapped
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(np.zeros(6))
    env.reset(seed=1)
    with pytest.raises(ValueError, match="expected shape"):
        env.step(np.zeros(3))
    assert env.step(np.zeros(6))[1] == -1.0


def test_unknown_signal_names_the_known_ones():
    with pytest.raises(ValueError, match="no signal 'force'; the signals are: "):
        make(observation=("force",))
