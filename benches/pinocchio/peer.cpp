// What Pinocchio takes for the operations that opspace has too, on one thread: `peer URDF TIP_FRAME`.
//
// stdout: a line for each operation, `name median_ns`. stderr: checksums, heap allocations, and how far the
// operational-space ticks are from the textbook's formulas. How it is measured, and what each name is: README.md.

#include "../common/peer.hpp"

#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/centroidal.hpp>
#include <pinocchio/algorithm/cholesky.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace
{
  using Eigen::VectorXd;
  using pinocchio::Convention;
  using pinocchio::Data;
  using pinocchio::Model;
  using pinocchio::SE3;
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;

  constexpr auto WORLD_ALIGNED = pinocchio::LOCAL_WORLD_ALIGNED;
  // Relative; random states come close to singularities, where digits are lost.
  constexpr double TICK_TOLERANCE = 1e-6;
  // Of the robots without a tick of their own fixed size.
  constexpr int MAX_JOINTS = 64;

  // The gains of the task and of the posture: ω² and 2ζω.
  constexpr double TASK_STIFFNESS = 200.0, TASK_DAMPING = 28.3;
  constexpr double POSTURE_STIFFNESS = 40.0, POSTURE_DAMPING = 10.0;

  /// What a control tick is given, and inputs of the other operations.
  struct State
  {
    VectorXd q;      // nq: a continuous joint is a cosine and a sine
    VectorXd angles; // nv: the same, one number a joint
    VectorXd dq, ddq, tau;
    SE3 tip_desired; // near the tip's own pose
  };

  std::vector<State> random_states(const Model & model, Data & data, pinocchio::FrameIndex tip)
  {
    Random random;
    std::vector<State> states(STATES);
    for (State & state : states)
    {
      state.q.resize(model.nq);
      for (VectorXd * v : {&state.angles, &state.dq, &state.ddq, &state.tau})
        v->resize(model.nv);
      for (int j = 1; j < model.njoints; ++j)
      {
        const int iv = model.idx_vs[j];
        const Range range(model, j);
        const double effort = std::min(model.upperEffortLimit[iv], 20.0);
        state.angles[iv] = random.uniform(range.low, range.high);
        set_angle(model, j, state.angles[iv], state.q);
        state.dq[iv] = random.uniform(-range.speed, range.speed);
        state.ddq[iv] = random.uniform(-5.0, 5.0);
        state.tau[iv] = random.uniform(-effort, effort);
      }
      pinocchio::framesForwardKinematics(model, data, state.q);
      state.tip_desired = random.near(data.oMf[tip], 0.1);
    }
    return states;
  }

  /// The acceleration asked of the tip: a PD law on its pose; linear first, world axes.
  Vector6 tip_acceleration(const SE3 & desired, const SE3 & tip, const Vector6 & velocity)
  {
    Vector6 error;
    error.head<3>() = desired.translation() - tip.translation();
    error.tail<3>() = pinocchio::log3(desired.rotation() * tip.rotation().transpose());
    return TASK_STIFFNESS * error - TASK_DAMPING * velocity;
  }

  /// An operational-space tick of a six-row task at the tip, and a posture in its nullspace:
  ///   Λ = (J M⁻¹ Jᵀ)⁻¹,  J̄ = M⁻¹ Jᵀ Λ,  τ = Jᵀ Λ (ẍ − J̇ q̇) + (I − Jᵀ J̄ᵀ) M q̈_posture + h.
  /// M⁻¹ is never formed: with M = L Lᵀ and Y = L⁻¹ Jᵀ, Λ⁻¹ = Yᵀ Y and J̄ = L⁻ᵀ Y Λ.
  /// N is the number of joints where it is known at compile time; there is no heap either way.
  template<int N>
  struct Tick
  {
    static constexpr int MAX = N == Eigen::Dynamic ? MAX_JOINTS : N;
    using Vector = Eigen::Matrix<double, N, 1, 0, MAX, 1>;
    using Square = Eigen::Matrix<double, N, N, 0, MAX, MAX>;
    using Wide = Eigen::Matrix<double, 6, N, 0, 6, MAX>;
    using Tall = Eigen::Matrix<double, N, 6, 0, MAX, 6>;

    const Model & model;
    Data data;
    pinocchio::FrameIndex tip;
    Vector posture;

    Wide jacobian;                       // 6 n; world axes, at the tip, linear rows first
    Vector6 jdot_dq;                     // the tip's classical acceleration with q̈ = 0
    Square mass_matrix;                  // n n, both triangles
    Matrix6 task_inertia;                // Λ
    Tall dynamically_consistent_inverse; // J̄, n 6
    Vector torque;                       // n

    Tick(const Model & model, pinocchio::FrameIndex tip, const VectorXd & posture)
    : model(model)
    , data(model)
    , tip(tip)
    , posture(posture)
    , jacobian(Wide::Zero(6, model.nv)) // getFrameJacobian leaves other branches' columns alone
    , mass_matrix(Square::Zero(model.nv, model.nv))
    , dynamically_consistent_inverse(Tall::Zero(model.nv, 6))
    , torque(Vector::Zero(model.nv))
    {
    }

    void update(const State & state)
    {
      // In the world's convention crba leaves the joints' placements and Jacobian, nonLinearEffects their
      // velocities and accelerations with q̈ = 0 and gravity upwards: no other pass is needed.
      pinocchio::crba(model, data, state.q, Convention::WORLD);
      pinocchio::nonLinearEffects(model, data, state.q, state.dq);
      pinocchio::getFrameJacobian(model, data, tip, WORLD_ALIGNED, jacobian);
      const auto & frame = model.frames[tip];
      const SE3 placement = data.oMi[frame.parentJoint] * frame.placement;
      const auto velocity = frame.placement.actInv(data.v[frame.parentJoint]);
      const auto acceleration = frame.placement.actInv(data.a_gf[frame.parentJoint]);
      const auto & rotation = placement.rotation();
      Vector6 tip_velocity;
      tip_velocity << rotation * velocity.linear(), rotation * velocity.angular();
      jdot_dq.template head<3>() =
        rotation * (acceleration.linear() + velocity.angular().cross(velocity.linear()))
        + model.gravity.linear();
      jdot_dq.template tail<3>() = rotation * acceleration.angular();

      mass_matrix = data.M;
      mass_matrix.template triangularView<Eigen::StrictlyLower>() = data.M.transpose();
      factor();

      const Vector6 asked = tip_acceleration(state.tip_desired, placement, tip_velocity) - jdot_dq;
      const Vector ddq = POSTURE_STIFFNESS * (posture - state.angles) - POSTURE_DAMPING * state.dq;
      torque.noalias() = mass_matrix * ddq;
      const Vector6 force =
        task_inertia * asked - dynamically_consistent_inverse.transpose() * torque;
      torque.noalias() += jacobian.transpose() * force;
      torque += data.nle;
    }

    /// Λ and J̄. The products are lazy because Eigen's blocked one is slower on six columns.
    void factor()
    {
      const Eigen::LLT<Square> llt(mass_matrix);
      Tall y = jacobian.transpose();
      llt.matrixL().solveInPlace(y);
      const Eigen::LDLT<Matrix6> inverse(y.transpose().lazyProduct(y));
      task_inertia.setIdentity();
      inverse.solveInPlace(task_inertia);
      dynamically_consistent_inverse = y.lazyProduct(task_inertia);
      llt.matrixU().solveInPlace(dynamically_consistent_inverse);
    }
  };

  /// The tick's torque again by other algorithms, all inverses formed and nothing shared.
  VectorXd textbook_torque(
    const Model & model, Data & data, pinocchio::FrameIndex tip, const VectorXd & posture, const State & state)
  {
    const int n = model.nv;
    const VectorXd zero = VectorXd::Zero(n);
    pinocchio::forwardKinematics(model, data, state.q, state.dq, zero);
    const SE3 placement = pinocchio::updateFramePlacement(model, data, tip);
    const Vector6 bias =
      pinocchio::getFrameClassicalAcceleration(model, data, tip, WORLD_ALIGNED).toVector();
    Data::Matrix6x jacobian = Data::Matrix6x::Zero(6, n);
    pinocchio::computeFrameJacobian(model, data, state.q, tip, WORLD_ALIGNED, jacobian);
    // M by columns of the inverse dynamics.
    const VectorXd h = pinocchio::rnea(model, data, state.q, state.dq, zero);
    Eigen::MatrixXd mass_matrix(n, n);
    for (int j = 0; j < n; ++j)
      mass_matrix.col(j) = pinocchio::rnea(model, data, state.q, state.dq, VectorXd::Unit(n, j)) - h;

    const Eigen::MatrixXd minv = mass_matrix.inverse();
    const Matrix6 lambda = (jacobian * minv * jacobian.transpose()).inverse();
    const Eigen::MatrixXd jbar = minv * jacobian.transpose() * lambda;
    const Eigen::MatrixXd nullspace = Eigen::MatrixXd::Identity(n, n) - jbar * jacobian;
    const Vector6 asked = tip_acceleration(state.tip_desired, placement, jacobian * state.dq);
    const VectorXd ddq = POSTURE_STIFFNESS * (posture - state.angles) - POSTURE_DAMPING * state.dq;
    return jacobian.transpose() * lambda * (asked - bias) + nullspace.transpose() * mass_matrix * ddq + h;
  }

  /// Pinocchio's own operations; `fixed` keeps the M that is factored.
  void add_library(
    Bench & bench, const std::vector<State> & states, const Model & model, pinocchio::FrameIndex tip, Data & data,
    Data & fixed)
  {
    const int last = model.nv - 1;
    bench.add("fk", states, [&](const State & s) {
      pinocchio::forwardKinematics(model, data, s.q);
      return data.oMi.back().translation()[0];
    });
    const Data::Matrix6x zero = Data::Matrix6x::Zero(6, model.nv);
    bench.add("fk_jacobian", states, [&model, &data, tip, jacobian = zero](const State & s) mutable {
      pinocchio::computeJointJacobians(model, data, s.q);
      pinocchio::updateFramePlacement(model, data, tip);
      pinocchio::getFrameJacobian(model, data, tip, WORLD_ALIGNED, jacobian);
      return jacobian(0, 0) + data.oMf[tip].translation()[0];
    });
    bench.add("crba", states, [&](const State & s) {
      return pinocchio::crba(model, data, s.q, Convention::LOCAL)(0, 0);
    });
    bench.add("rnea", states, [&](const State & s) {
      return pinocchio::rnea(model, data, s.q, s.dq, s.ddq)[0];
    });
    bench.add("gravity", states, [&](const State & s) {
      return pinocchio::computeGeneralizedGravity(model, data, s.q)[1];
    });
    bench.add("bias", states, [&](const State & s) {
      return pinocchio::nonLinearEffects(model, data, s.q, s.dq)[0];
    });
    for (const Convention convention : {Convention::LOCAL, Convention::WORLD})
      bench.add("aba", states, [&, convention](const State & s) {
        return pinocchio::aba(model, data, s.q, s.dq, s.tau, convention)[0];
      });
    bench.add("minverse_triangle", states, [&](const State & s) {
      return pinocchio::computeMinverse(model, data, s.q)(0, 1);
    });
    bench.add("minverse", states, [&](const State & s) {
      pinocchio::computeMinverse(model, data, s.q);
      data.Minv.triangularView<Eigen::StrictlyLower>() = data.Minv.transpose();
      return data.Minv(1, 0);
    });
    bench.add("cholesky", states, [&](const State &) {
      pinocchio::cholesky::decompose(model, fixed);
      return fixed.D[0];
    });
    bench.add("derivatives_rnea", states, [&](const State & s) {
      pinocchio::computeRNEADerivatives(model, data, s.q, s.dq, s.ddq);
      return data.dtau_dq(1, 1) + data.dtau_dv(1, 1) + data.M(0, 0);
    });
    bench.add("derivatives_aba", states, [&](const State & s) {
      pinocchio::computeABADerivatives(model, data, s.q, s.dq, s.tau);
      return data.ddq_dq(1, 1) + data.ddq_dv(1, 1) + data.Minv(0, 0);
    });
    bench.add("centroidal", states, [&](const State & s) {
      return pinocchio::ccrba(model, data, s.q, s.dq)(0, 0);
    });
    bench.add("regressor", states, [&, last](const State & s) {
      return pinocchio::computeJointTorqueRegressor(model, data, s.q, s.dq, s.ddq)(last, 10 * last + 9);
    });
  }

  /// The tick's worst relative error over the states.
  template<int N>
  double tick_error(Tick<N> & tick, Data & data, const std::vector<State> & states)
  {
    double worst = 0.0;
    for (const State & state : states)
    {
      tick.update(state);
      const VectorXd expected = textbook_torque(tick.model, data, tick.tip, tick.posture, state);
      const double error = (expected - tick.torque).norm() / expected.norm();
      worst = error <= worst ? worst : error; // a NaN stays
    }
    return worst;
  }

  template<int N>
  void measure(const Model & model, pinocchio::FrameIndex tip)
  {
    Data data(model), fixed(model);
    const std::vector<State> states = random_states(model, data, tip);
    pinocchio::crba(model, fixed, states[0].q, Convention::LOCAL);
    Tick<N> tick(model, tip, VectorXd::Constant(model.nv, 0.3));
    const double error = tick_error(tick, data, states);
    std::fprintf(stderr, "osc_tick: relative error of the torque at most %.1e\n", error);
    if (!(error < TICK_TOLERANCE))
      throw std::runtime_error("osc_tick does not agree with the textbook");

    Bench bench;
    add_library(bench, states, model, tip, data, fixed);
    bench.add("osc_tick", states, [&](const State & state) {
      tick.update(state);
      return tick.torque[0];
    });
    bench.run();
  }

  void run(const std::string & urdf, const std::string & tip_name)
  {
    const Robot robot(urdf, tip_name);
    const Model & model = robot.model;
    const auto tip = robot.tip;
    if (model.frames[tip].parentJoint == 0)
      throw std::runtime_error("the frame '" + tip_name + "' does not move");
    if (model.nv < 2 || model.nv > MAX_JOINTS)
      throw std::runtime_error("2 to " + std::to_string(MAX_JOINTS) + " joints are wanted");

    switch (model.nv)
    {
    case 6: return measure<6>(model, tip);
    case 7: return measure<7>(model, tip);
    case 9: return measure<9>(model, tip);
    default: return measure<Eigen::Dynamic>(model, tip);
    }
  }
} // namespace

int main(int argc, char ** argv)
{
  return main_of(run, argc, argv);
}
