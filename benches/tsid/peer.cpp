// What a tick of TSID takes, on one thread: `peer URDF TIP_FRAME`.
//
// A tick: a pose task at the tip and a posture by weights, within bounds of torque, velocity and acceleration, as a QP.
// stdout: lines `name number`. stderr: smallest and largest times, heap allocations, active bounds, how far the solutions
// are from the optimum. How it is measured, and what each name is: README.md.

#include "../common/peer.hpp"

#include <tsid/formulations/inverse-dynamics-formulation-acc-force.hpp>
#include <tsid/robots/robot-wrapper.hpp>
#include <tsid/solvers/solver-HQP-eiquadprog-fast.hpp>
#include <tsid/solvers/solver-HQP-output.hpp>
#include <tsid/tasks/task-actuation-bounds.hpp>
#include <tsid/tasks/task-joint-bounds.hpp>
#include <tsid/tasks/task-joint-posture.hpp>
#include <tsid/tasks/task-se3-equality.hpp>

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <Eigen/QR>

#include <chrono>
#include <limits>

namespace
{
  using Eigen::MatrixXd;
  using Eigen::VectorXd;
  using pinocchio::Data;
  using pinocchio::Model;
  using pinocchio::SE3;
  using tsid::robots::RobotWrapper;
  using tsid::solvers::HQPOutput;
  using tsid::trajectories::TrajectorySample;
  using Vector6 = Eigen::Matrix<double, 6, 1>;

  // Of the torque, of a bound's violation and of the gradient at the optimum; relative.
  constexpr double TOLERANCE = 1e-6;

  // ω² and 2ζω of the task and of the posture, and their weights in the QP.
  constexpr double TASK_STIFFNESS = 200.0, TASK_DAMPING = 28.3, TASK_WEIGHT = 1.0;
  constexpr double POSTURE_STIFFNESS = 40.0, POSTURE_DAMPING = 10.0, POSTURE_WEIGHT = 1e-3;
  // What TSID adds to the Hessian's diagonal.
  constexpr double REGULARIZATION = 1e-8;
  // A velocity bound is one on the acceleration over this time, s.
  constexpr double PERIOD = 1e-3;
  // Of each joint: a URDF has none, rad/s².
  constexpr double MAX_ACCELERATION = 500.0;

  /// What a tick is given. The targets are ready samples, for a controller has them from its trajectory.
  struct State
  {
    VectorXd q;       // nq: a continuous joint is a cosine and a sine
    VectorXd dq;      // nv
    SE3 tip_desired;
    TrajectorySample tip;     // the same
    TrajectorySample posture; // nq
  };

  // The tip's target is off by at most so much in each of six coordinates, m and rad.
  constexpr double NEAR = 0.1, FAR = 1.0;
  // The posture's target, of all joints; rad.
  constexpr double POSTURE = 0.3;

  /// Random states.
  class Source
  {
    const Model & model;
    pinocchio::FrameIndex tip;
    Data data;
    Random random;

  public:
    Source(const Model & model, pinocchio::FrameIndex tip)
    : model(model)
    , tip(tip)
    , data(model)
    {
    }

    /// Its target off by at most `distance` in each of six coordinates, m and rad.
    State state(double distance)
    {
      State state{
        VectorXd(model.nq), VectorXd(model.nv), SE3::Identity(), TrajectorySample(12, 6),
        TrajectorySample(model.nq, model.nv)};
      VectorXd posture(model.nq);
      for (int j = 1; j < model.njoints; ++j)
      {
        const Range range(model, j);
        set_angle(model, j, random.uniform(range.low, range.high), state.q);
        set_angle(model, j, POSTURE, posture);
        state.dq[model.idx_vs[j]] = random.uniform(-range.speed, range.speed);
      }
      state.posture.setValue(posture);
      pinocchio::framesForwardKinematics(model, data, state.q);
      state.tip_desired = random.near(data.oMf[tip], distance);
      VectorXd value(12);
      value.head<3>() = state.tip_desired.translation();
      Eigen::Map<Eigen::Matrix3d>(value.data() + 3) = state.tip_desired.rotation();
      state.tip.setValue(value);
      return state;
    }
  };

  /// TSID's tick.
  class Tick
  {
    RobotWrapper robot;
    tsid::InverseDynamicsFormulationAccForce formulation;
    tsid::tasks::TaskSE3Equality tip;
    tsid::tasks::TaskJointPosture posture;
    tsid::tasks::TaskActuationBounds torque_bounds;
    tsid::tasks::TaskJointBounds joint_bounds;
    tsid::solvers::SolverHQuadProgFast solver;

  public:
    const HQPOutput * solution = nullptr;

    Tick(const Model & model, const std::string & tip_name)
    : robot(model, RobotWrapper::FIXED_BASE_SYSTEM)
    , formulation("formulation", robot)
    , tip("tip", robot, tip_name)
    , posture("posture", robot)
    , torque_bounds("torque bounds", robot)
    , joint_bounds("joint bounds", robot, PERIOD)
    , solver("solver")
    {
      const VectorXd ones = VectorXd::Ones(model.nv);
      tip.Kp(TASK_STIFFNESS * Vector6::Ones());
      tip.Kd(TASK_DAMPING * Vector6::Ones());
      posture.Kp(POSTURE_STIFFNESS * ones);
      posture.Kd(POSTURE_DAMPING * ones);
      torque_bounds.setBounds(-model.upperEffortLimit, model.upperEffortLimit);
      joint_bounds.setVelocityBounds(-model.upperVelocityLimit, model.upperVelocityLimit);
      joint_bounds.setAccelerationBounds(-MAX_ACCELERATION * ones, MAX_ACCELERATION * ones);
      formulation.addMotionTask(tip, TASK_WEIGHT, 1);
      formulation.addMotionTask(posture, POSTURE_WEIGHT, 1);
      formulation.addActuationTask(torque_bounds, 1.0, 0);
      formulation.addMotionTask(joint_bounds, 1.0, 0);
      solver.resize(formulation.nVar(), formulation.nEq(), formulation.nIn());
    }

    /// The QP without its solution.
    const tsid::solvers::HQPData & problem(State & state)
    {
      tip.setReference(state.tip);
      posture.setReference(state.posture);
      return formulation.computeProblemData(0.0, state.q, state.dq);
    }

    /// The torques; they mean something if `solved`.
    const VectorXd & update(State & state)
    {
      solution = &solver.solve(problem(state));
      return formulation.getActuatorForces(*solution);
    }

    bool solved() const
    {
      return solution->status == tsid::solvers::HQP_STATUS_OPTIMAL;
    }
  };

  /// The tick's QP again by other algorithms, in q̈:
  ///   minimise ½ q̈ᵀ H q̈ − gᵀ q̈ within lower ≤ A q̈ ≤ upper, A = [M; 1].
  struct Reference
  {
    MatrixXd hessian, bounded;
    VectorXd gradient, lower, upper, bias;

    Reference(const Model & model, Data & data, pinocchio::FrameIndex tip, const State & state)
    {
      const int n = model.nv;
      const VectorXd zero = VectorXd::Zero(n);
      bias = pinocchio::rnea(model, data, state.q, state.dq, zero);
      bounded.resize(2 * n, n);
      bounded.bottomRows(n).setIdentity();
      for (int j = 0; j < n; ++j)
        bounded.col(j).head(n) = pinocchio::rnea(model, data, state.q, state.dq, VectorXd::Unit(n, j)) - bias;
      lower.resize(2 * n);
      upper.resize(2 * n);
      lower << -model.upperEffortLimit - bias,
        ((-model.upperVelocityLimit - state.dq) / PERIOD).cwiseMax(-MAX_ACCELERATION);
      upper << model.upperEffortLimit - bias,
        ((model.upperVelocityLimit - state.dq) / PERIOD).cwiseMin(MAX_ACCELERATION);

      // The tip's task in its own axes.
      Data::Matrix6x jacobian = Data::Matrix6x::Zero(6, n);
      pinocchio::computeFrameJacobian(model, data, state.q, tip, pinocchio::LOCAL, jacobian);
      pinocchio::forwardKinematics(model, data, state.q, state.dq, zero);
      const SE3 place = pinocchio::updateFramePlacement(model, data, tip);
      const Vector6 drift =
        pinocchio::getFrameClassicalAcceleration(model, data, tip, pinocchio::LOCAL).toVector();
      const SE3 behind = place.actInv(state.tip_desired);
      Vector6 error;
      error << behind.translation(), pinocchio::log3(behind.rotation());
      const Vector6 asked = TASK_STIFFNESS * error - TASK_DAMPING * jacobian * state.dq - drift;
      const VectorXd rest =
        POSTURE_STIFFNESS * pinocchio::difference(model, state.q, state.posture.getValue())
        - POSTURE_DAMPING * state.dq;

      hessian = TASK_WEIGHT * jacobian.transpose() * jacobian;
      hessian.diagonal().array() += POSTURE_WEIGHT + REGULARIZATION;
      gradient = TASK_WEIGHT * jacobian.transpose() * asked + POSTURE_WEIGHT * rest;
    }

    /// How far q̈ and its torque are from the optimum, relative: the equations of Karush, Kuhn and Tucker, which suffice
    /// because H is positive definite.
    double error(const VectorXd & ddq, const VectorXd & tau) const
    {
      const int n = ddq.size();
      const VectorXd at = bounded * ddq;
      const VectorXd scale = lower.cwiseAbs().cwiseMax(upper.cwiseAbs()).cwiseMax(1.0);
      double worst = (at.head(n) + bias - tau).norm() / tau.norm();
      const VectorXd slack = (at - lower).cwiseMin(upper - at).cwiseQuotient(scale);
      worst = std::max(worst, -slack.minCoeff());

      // The slope must be a sum of the normals of the bounds reached, pointing inwards, with no negative factor.
      MatrixXd normals(n, 0);
      for (int i = 0; i < 2 * n; ++i)
        if (slack[i] < TOLERANCE)
        {
          normals.conservativeResize(n, normals.cols() + 1);
          const bool low = at[i] - lower[i] < upper[i] - at[i];
          normals.col(normals.cols() - 1) = bounded.row(i).transpose() * (low ? 1.0 : -1.0);
        }
      const VectorXd slope = hessian * ddq - gradient;
      const double size = (hessian * ddq).norm() + gradient.norm();
      VectorXd left = slope;
      if (normals.cols() > 0)
        left -= normals * normals.colPivHouseholderQr().solve(slope).cwiseMax(0.0);
      return std::max(worst, left.norm() / size);
    }
  };

  /// States at each of which the QP has a solution, and what the solutions are like.
  struct Set
  {
    std::vector<State> states;
    int unsolvable = 0;
    double active = 0.0;     // the share of states with an active bound
    double torque = 0.0;     // active bounds of torque, on average
    double joint = 0.0;      // of velocity or acceleration
    double iterations = 0.0; // of the solver, on average
    double error = 0.0;      // the worst distance from the optimum

    /// With `only_free`, states without an active bound.
    Set(const Model & model, pinocchio::FrameIndex tip, Tick & tick, double distance, bool only_free = false)
    {
      Data data(model);
      Source source(model, tip);
      for (int drawn = 0; states.size() < STATES; ++drawn)
      {
        if (drawn == 100 * STATES)
          throw std::runtime_error("hardly any state has a solution, or one without an active bound");
        State state = source.state(distance);
        const VectorXd torques = tick.update(state);
        const HQPOutput & solution = *tick.solution;
        unsolvable += !tick.solved();
        if (!tick.solved() || (only_free && solution.activeSet.size() > 0))
          continue;
        // The torques' 2 n inequalities come first.
        const double of_torque = (solution.activeSet.array() < 2 * model.nv).count();
        active += (solution.activeSet.size() > 0) / double(STATES);
        torque += of_torque / STATES;
        joint += (solution.activeSet.size() - of_torque) / STATES;
        iterations += solution.iterations / double(STATES);
        const double off = Reference(model, data, tip, state).error(solution.x, torques);
        error = off <= error ? error : off; // a NaN stays
        states.push_back(state);
      }
    }

    void report(const char * name) const
    {
      std::fprintf(
        stderr,
        "%s: %.1f %% of the states with active bounds; on average %.2f of torque, %.2f of velocity or acceleration, "
        "%.2f iterations; %d states left out without a solution; at most %.1e from the optimum\n",
        name, 100.0 * active, torque, joint, iterations, unsolvable, error);
      if (!(error < TOLERANCE))
        throw std::runtime_error(std::string(name) + " is not the optimum");
    }
  };

  /// A QP needs numbers, and a URDF may lack them.
  void check_limits(const Model & model)
  {
    for (int j = 1; j < model.njoints; ++j)
      for (const double limit :
           {model.upperEffortLimit[model.idx_vs[j]], model.upperVelocityLimit[model.idx_vs[j]]})
        if (!(limit > 0.0 && limit < 1e6))
          throw std::runtime_error("the joint '" + model.names[j] + "' has no limit of effort or of velocity");
  }

  /// Prints the median and the largest duration of single ticks, ns: of each state the least of `LEAST_OF`, as
  /// benches/limited.rs of opspace measures its ticks.
  constexpr int LEAST_OF = 5;

  template<typename Update>
  void time_single_ticks(const char * name, std::vector<State> & states, Update update)
  {
    std::vector<double> least(states.size(), std::numeric_limits<double>::infinity());
    double sum = 0.0;
    for (int repetition = 0; repetition < LEAST_OF; ++repetition)
      for (size_t i = 0; i < states.size(); ++i)
      {
        const auto start = std::chrono::steady_clock::now();
        sum += update(states[i]);
        const std::chrono::duration<double, std::nano> passed = std::chrono::steady_clock::now() - start;
        least[i] = std::min(least[i], passed.count());
      }
    if (!std::isfinite(sum))
      throw std::runtime_error(std::string(name) + " gave a number that is not finite");
    std::sort(least.begin(), least.end());
    std::printf("%s_median %.1f\n%s_worst %.1f\n", name, least[least.size() / 2], name, least.back());
  }

  void run(const std::string & urdf, const std::string & tip_name)
  {
    const Robot robot(urdf, tip_name);
    const Model & model = robot.model;
    const auto tip = robot.tip;
    check_limits(model);

    Tick tick(model, tip_name);
    Set drawn(model, tip, tick, NEAR), free(model, tip, tick, NEAR, true), far(model, tip, tick, FAR);
    drawn.report("tick");
    free.report("tick_free");
    far.report("tick_limits");

    const auto update = [&](State & state) { return tick.update(state)[0]; };
    Bench bench;
    bench.add("problem", drawn.states, [&](State & state) {
      return tick.problem(state)[1][0].second->vector()[0];
    });
    bench.add("tick", drawn.states, update);
    bench.add("tick_free", free.states, update);
    bench.add("tick_limits", far.states, update);
    bench.run();
    time_single_ticks("single", far.states, update);
    std::printf("active %.4f\nactive_limits %.4f\n", drawn.active, far.active);
  }
} // namespace

int main(int argc, char ** argv)
{
  return main_of(run, argc, argv);
}
