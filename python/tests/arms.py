"""Arms of MuJoCo's format, made here: what compiled models can have, and no file needs."""

SERIAL = """
<mujoco model="serial">
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="base" pos="0.1 -0.2 0.3" quat="0.9 0.1 -0.2 0.3">
      <geom type="sphere" size="0.1" mass="3"/>
      <body name="one" pos="0 0 0.1">
        <joint name="j1" axis="0 0 1" range="-2.9 2.9" limited="true" armature="0.2" frictionloss="1.5" damping="0.3"/>
        <inertial pos="0.01 0.03 0.1" quat="0.8 0.2 0.3 -0.4" mass="4.1" diaginertia="0.03 0.04 0.02"/>
        <body name="two" pos="0 0.05 0.3" euler="90 10 0">
          <joint name="j2" axis="0 1 0.2" pos="0.02 0 0.01" range="-1.7 1.7" limited="true" armature="0.15" ref="0.4"/>
          <inertial pos="0.02 0.1 0" mass="3.2" fullinertia="0.04 0.05 0.03 0.001 -0.002 0.003"/>
          <body name="three" pos="0.05 0.35 0" quat="0.5 0.5 -0.5 0.5">
            <joint name="j3" axis="1 0 0" armature="0.1" actuatorfrclimited="true" actuatorfrcrange="-40 60"/>
            <inertial pos="0 0.02 0.12" mass="2.0" diaginertia="0.01 0.012 0.008"/>
            <body name="four" pos="0 0 0.3">
              <joint name="j4" type="slide" axis="0.1 0 1" range="0 0.2" limited="true" ref="0.05"/>
              <inertial pos="0 0.01 0" mass="1.1" diaginertia="0.004 0.004 0.003"/>
              <body name="wrist" pos="0 0.02 0.1" quat="0.7 0.1 0.7 0">
                <joint name="j5" axis="0 0 1" armature="0.02"/>
                <joint name="j6" axis="0 1 0" pos="0 0 0.03" armature="0.02"/>
                <joint name="j7" axis="1 0 0" armature="0.01" damping="0.1"/>
                <inertial pos="0.01 0 0.05" mass="0.8" diaginertia="0.001 0.0012 0.0009"/>
                <site name="tool" pos="0.03 -0.01 0.12" quat="0.6 0 0.8 0"/>
                <body name="plate" pos="0 0 0.1" euler="0 20 0"><geom type="box" size="0.02 0.03 0.01" mass="0.2"/></body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

# Two fingers of which the second follows the first, a tree of two arms, and a box that is no part of the robot.
GRIPPER = """
<mujoco model="gripper">
  <option gravity="1 -2 -9"/>
  <worldbody>
    <body name="box" pos="1 0 0.2"><freejoint name="box_joint"/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
    <body name="torso" pos="0 0 1">
      <joint name="yaw" axis="0 0 1" armature="0.3"/>
      <geom type="capsule" size="0.1 0.3" mass="9"/>
      <body name="left" pos="0 0.2 0.2" euler="30 0 20">
        <joint name="left_shoulder" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.3 0" size="0.05" mass="2"/>
        <body name="hand" pos="0.1 0.3 0">
          <joint name="left_elbow" axis="1 0 0" armature="0.01"/>
          <geom type="capsule" fromto="0 0 0 0 0.2 0.1" size="0.04" mass="1"/>
          <body name="finger" pos="0 0.2 0.1">
            <joint name="finger_joint" type="slide" axis="1 0 0" range="0 0.04" limited="true" armature="0.1" ref="0.01"/>
            <geom type="box" size="0.01 0.02 0.05" mass="0.1"/>
          </body>
          <body name="thumb" pos="0 0.2 0.15">
            <joint name="thumb_joint" type="hinge" axis="0 0 1" armature="0.05" ref="0.2"/>
            <geom type="box" size="0.01 0.02 0.05" pos="0.02 0 0" mass="0.15"/>
          </body>
        </body>
      </body>
      <body name="right" pos="0 -0.2 0.2">
        <joint name="right_shoulder" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.2 -0.3 0.1" size="0.05" mass="2.5"/>
        <site name="right_tip" pos="0.2 -0.3 0.1"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint joint1="thumb_joint" joint2="finger_joint" polycoef="0.1 12 0 0 0"/>
    <joint joint1="right_shoulder" polycoef="0.3 0 0 0 0"/>
  </equality>
</mujoco>
"""

# Sizes like those of a common industrial arm: six hinges.
SIX = """
<mujoco model="six">
  <worldbody>
    <body name="shoulder" pos="0 0 0.163">
      <joint name="pan" axis="0 0 1" armature="0.1" range="-6.28 6.28" limited="true"/>
      <inertial pos="0 0 0" mass="3.7" diaginertia="0.0103 0.0103 0.0067"/>
      <body name="upper" pos="0 0.138 0" quat="0.707 0 0.707 0">
        <joint name="lift" axis="0 1 0" armature="0.1"/>
        <inertial pos="0 0 0.2125" mass="8.39" diaginertia="0.1339 0.1339 0.0151"/>
        <body name="fore" pos="0 -0.131 0.425">
          <joint name="elbow" axis="0 1 0" armature="0.1"/>
          <inertial pos="0 0 0.196" mass="2.33" diaginertia="0.0312 0.0312 0.0041"/>
          <body name="wrist1" pos="0 0 0.392" quat="0.707 0 0.707 0">
            <joint name="w1" axis="0 1 0" armature="0.1"/>
            <inertial pos="0 0.127 0" mass="1.22" diaginertia="0.0026 0.0026 0.0022"/>
            <body name="wrist2" pos="0 0.127 0">
              <joint name="w2" axis="0 0 1" armature="0.1"/>
              <inertial pos="0 0 0.1" mass="1.22" diaginertia="0.0026 0.0026 0.0022"/>
              <body name="wrist3" pos="0 0 0.1">
                <joint name="w3" axis="0 1 0" armature="0.1"/>
                <inertial pos="0 0.077 0" mass="0.19" diaginertia="0.0001 0.0001 0.0001"/>
                <site name="flange" pos="0 0.1 0" quat="-1 1 0 0"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
