// What every peer has in common: its arguments, its robot, random states of it, and how it is timed.
//
// Defines malloc: to be included once in a program.

#pragma once

#include <pinocchio/multibody/data.hpp>
#include <pinocchio/multibody/model.hpp>
#include <pinocchio/parsers/urdf.hpp>
#include <pinocchio/spatial/explog.hpp>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

// Every allocation of the process comes by here, the shared libraries' and Eigen's too.
static long allocations = 0;
extern "C" void * __libc_malloc(std::size_t);
extern "C" void * malloc(std::size_t size) noexcept
{
  ++allocations;
  return __libc_malloc(size);
}

namespace
{
  constexpr int STATES = 1024;
  constexpr int CALLS = 10000;
  constexpr int REPETITIONS = 15;

  /// The operations and their times.
  class Bench
  {
    struct Operation
    {
      std::string name;
      std::function<double()> pass; // all calls of a repetition; the sum of what they return
      double checksum = 0.0;
      long allocated = 0;
      std::array<double, REPETITIONS> ns = {};
    };

    std::vector<Operation> operations;

  public:
    /// `call` takes one of the `states` and returns a number of its result. Operations of the same name are alternatives.
    template<typename List, typename Call>
    void add(const char * name, List & states, Call call)
    {
      const auto pass = [&states, call]() mutable {
        double sum = 0.0;
        for (int i = 0; i < CALLS; ++i)
        {
          sum += call(states[i % STATES]);
          asm volatile("" ::: "memory"); // all of the result counts as read
        }
        return sum;
      };
      operations.push_back({name, pass});
    }

    /// Times and prints. The repetitions go round the operations, so that a burst of other load falls on all.
    void run()
    {
      for (Operation & operation : operations)
        operation.pass(); // warms up
      for (int repetition = 0; repetition < REPETITIONS; ++repetition)
        for (Operation & operation : operations)
          repeat(operation, repetition);
      std::map<std::string, double> fastest;
      for (Operation & operation : operations)
      {
        std::sort(operation.ns.begin(), operation.ns.end());
        const double median = operation.ns[REPETITIONS / 2];
        std::fprintf(
          stderr, "%s: min %.1f median %.1f max %.1f ns, %g allocations a call, checksum %.9g\n",
          operation.name.c_str(), operation.ns.front(), median, operation.ns.back(),
          double(operation.allocated) / (REPETITIONS * CALLS), operation.checksum);
        if (!std::isfinite(operation.checksum))
          throw std::runtime_error(operation.name + " gave a number that is not finite");
        const auto [best, first] = fastest.emplace(operation.name, median);
        best->second = std::min(best->second, median);
      }
      for (const auto & [name, ns] : fastest)
        std::printf("%s %.1f\n", name.c_str(), ns);
    }

  private:
    static void repeat(Operation & operation, int repetition)
    {
      const long allocated = allocations;
      const auto start = std::chrono::steady_clock::now();
      operation.checksum += operation.pass();
      const std::chrono::duration<double, std::nano> passed = std::chrono::steady_clock::now() - start;
      operation.ns[repetition] = passed.count() / CALLS;
      operation.allocated += allocations - allocated;
    }
  };

  /// Draws uniformly, with a fixed seed.
  class Random
  {
    std::mt19937_64 generator{1};

  public:
    double uniform(double low, double high)
    {
      return std::uniform_real_distribution<double>(low, high)(generator);
    }

    /// A pose off by at most `distance` in each of six coordinates, m and rad.
    pinocchio::SE3 near(const pinocchio::SE3 & pose, double distance)
    {
      Eigen::Matrix<double, 6, 1> offset;
      for (double & x : offset)
        x = uniform(-distance, distance);
      return pose * pinocchio::exp6(pinocchio::Motion(offset));
    }
  };

  /// Where a joint's states are drawn from: within its limits, as the oracles of ../../tests/oracles/pinocchio are.
  struct Range
  {
    double low, high; // of the angle, rad
    double speed;     // rad/s

    Range(const pinocchio::Model & model, int joint)
    {
      const int iq = model.idx_qs[joint];
      const bool continuous = model.nqs[joint] == 2;
      low = continuous ? -M_PI : std::max(model.lowerPositionLimit[iq], -M_PI);
      high = continuous ? M_PI : std::min(model.upperPositionLimit[iq], M_PI);
      speed = std::min(model.upperVelocityLimit[model.idx_vs[joint]], 3.0);
    }
  };

  /// A joint's `angle` as it stands in q: a continuous joint is a cosine and a sine.
  void set_angle(const pinocchio::Model & model, int joint, double angle, Eigen::VectorXd & q)
  {
    const int iq = model.idx_qs[joint];
    if (model.nqs[joint] == 2)
      q.segment<2>(iq) << std::cos(angle), std::sin(angle);
    else
      q[iq] = angle;
  }

  /// The robot of a URDF, and the frame of it that has a task.
  struct Robot
  {
    pinocchio::Model model;
    pinocchio::FrameIndex tip;

    Robot(const std::string & urdf, const std::string & tip_name)
    {
      pinocchio::urdf::buildModel(urdf, model);
      if (!model.existFrame(tip_name))
      {
        std::string names;
        for (const auto & frame : model.frames)
          names += " " + frame.name;
        throw std::runtime_error("no frame '" + tip_name + "' in " + urdf + "; there are:" + names);
      }
      tip = model.getFrameId(tip_name);
    }
  };

  /// A peer's main: `run` takes the URDF's path and the tip's name. 1 is an error, 2 are bad arguments.
  int main_of(void (*run)(const std::string &, const std::string &), int argc, char ** argv)
  {
    if (argc != 3)
    {
      std::fprintf(stderr, "usage: %s URDF TIP_FRAME\n", argv[0]);
      return 2;
    }
    try
    {
      run(argv[1], argv[2]);
      return 0;
    }
    catch (const std::exception & error)
    {
      std::fprintf(stderr, "%s: %s\n", argv[0], error.what());
      return 1;
    }
  }
} // namespace
