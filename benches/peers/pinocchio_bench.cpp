// Measures Pinocchio's C++ algorithms on the models written by dump_models.py.
//
//   pinocchio_bench [--csv | --json | --accelerations | --serve] MODEL.bin...
//
// --csv             the default, one line per model: median nanoseconds per call of each algorithm
// --json            the same, with the compiler, the versions and the accelerations below
// --accelerations   no timing: CSV of the fixed state and of its joint accelerations, a line per degree of freedom.
//                   Another program must reproduce them before its times are compared: same model, same problem.
// --serve           prints a line of JSON, the compiler and the versions; then reads lines MODEL ALGORITHM SECONDS, measures
//                   for about that long, and answers each with a line: nanoseconds per call. Used by compare.py, which alternates
//                   between it and benches/turns.rs.
//
// Pinocchio is compiled from its headers here, because the shared library of the wheel is built for any x86-64.
#include <pinocchio/multibody.hpp>
#include <pinocchio/serialization.hpp>

#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/cholesky.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#ifndef COMPILE_FLAGS
#error "Build with install.sh: it passes the flags that the JSON reports."
#endif

using Eigen::VectorXd;
using pinocchio::Convention;
using pinocchio::Data;
using pinocchio::Model;

// ---- timing ------------------------------------------------------------------------------------------------------

constexpr int STATES = 256;              // cycled, so that no call sees the state of the call before it
constexpr double REPEAT_SECONDS = 2e-4;  // at the least, so that the clock's own cost vanishes
constexpr double SECONDS = 0.1;          // an algorithm, where nobody says how long

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

// The compiler must assume that the result is read here and that memory changes, so no call can be dropped or hoisted.
template <class Result> inline void consume(const Result& result) {
  asm volatile("" : : "r"(result.data()) : "memory");
}

// Median nanoseconds of `call(state)`, which returns the Eigen object that holds its result: one cycle through the states
// warms the caches, then repetitions of whole cycles fill `seconds`, as in benches/common/mod.rs.
template <class Call> double median_ns(double seconds, Call call) {
  const auto cycle = [&] {
    for (int state = 0; state < STATES; state++) consume(call(state));
  };
  cycle();
  std::vector<double> ns;
  const auto began = Clock::now();
  do {
    const auto start = Clock::now();
    int cycles = 0;
    double elapsed;
    do {
      cycle();
      cycles++;
      elapsed = seconds_since(start);
    } while (elapsed < REPEAT_SECONDS);
    ns.push_back(elapsed * 1e9 / (cycles * STATES));
  } while (seconds_since(began) < seconds);
  const auto middle = ns.begin() + ns.size() / 2;
  std::nth_element(ns.begin(), middle, ns.end());
  return *middle;
}

// Forward dynamics with the factorized mass matrix. On small robots it can be faster than the articulated-body algorithm.
const VectorXd& crba_forward_dynamics(const Model& model, Data& data, const VectorXd& q, const VectorXd& v,
                                      const VectorXd& tau) {
  pinocchio::nonLinearEffects(model, data, q, v);
  pinocchio::crba(model, data, q, Convention::LOCAL);
  pinocchio::cholesky::decompose(model, data);
  data.ddq = tau - data.nle;
  pinocchio::cholesky::solve(model, data, data.ddq);
  return data.ddq;
}

// All three matrices of each, in `data`; the first of them is given, as it is stored there.
const auto& rnea_derivatives(const Model& model, Data& data, const VectorXd& q, const VectorXd& v,
                             const VectorXd& a) {
  pinocchio::computeRNEADerivatives(model, data, q, v, a);
  return data.dtau_dq;
}

const auto& aba_derivatives(const Model& model, Data& data, const VectorXd& q, const VectorXd& v,
                            const VectorXd& tau) {
  pinocchio::computeABADerivatives(model, data, q, v, tau);
  return data.ddq_dq;
}

// A model with its data, and random states.
struct Problem {
  Model model;
  Data data;
  std::vector<VectorXd> q, v, a, tau;

  explicit Problem(const Model& given) : model(given), data(given) {
    std::srand(1);  // Eigen and Pinocchio use std::rand: every run has the same states
    const VectorXd bound = VectorXd::Ones(model.nq);
    for (int state = 0; state < STATES; state++) {
      q.push_back(pinocchio::randomConfiguration(model, -bound, bound));  // uniform orientation of a free joint
      v.push_back(VectorXd::Random(model.nv));
      a.push_back(VectorXd::Random(model.nv));
      tau.push_back(VectorXd::Random(model.nv));
    }
  }
};

// Every algorithm: `visit(name, call)`, where `call(state)` runs it.
template <class Visit> void each_algorithm(Problem& problem, Visit visit) {
  const Model& model = problem.model;
  Data& data = problem.data;
  const auto &q = problem.q, &v = problem.v, &a = problem.a, &tau = problem.tau;
  const auto factor = [&](int i, Convention convention) -> auto& {
    pinocchio::crba(model, data, q[i], convention);
    return pinocchio::cholesky::decompose(model, data);
  };
  // clang-format off
  visit("aba_local", [&](int i) -> auto& { return pinocchio::aba(model, data, q[i], v[i], tau[i], Convention::LOCAL); });
  visit("aba_world", [&](int i) -> auto& { return pinocchio::aba(model, data, q[i], v[i], tau[i], Convention::WORLD); });
  visit("crba_forward_dynamics", [&](int i) -> auto& { return crba_forward_dynamics(model, data, q[i], v[i], tau[i]); });
  visit("rnea", [&](int i) -> auto& { return pinocchio::rnea(model, data, q[i], v[i], a[i]); });
  visit("crba_local", [&](int i) -> auto& { return pinocchio::crba(model, data, q[i], Convention::LOCAL); });
  visit("crba_world", [&](int i) -> auto& { return pinocchio::crba(model, data, q[i], Convention::WORLD); });
  visit("crba_local_cholesky", [&](int i) -> auto& { return factor(i, Convention::LOCAL); });
  visit("crba_world_cholesky", [&](int i) -> auto& { return factor(i, Convention::WORLD); });
  visit("minverse", [&](int i) -> auto& { return pinocchio::computeMinverse(model, data, q[i]); });
  visit("rnea_derivatives", [&](int i) -> auto& { return rnea_derivatives(model, data, q[i], v[i], a[i]); });
  visit("aba_derivatives", [&](int i) -> auto& { return aba_derivatives(model, data, q[i], v[i], tau[i]); });
  // clang-format on
}

using Timings = std::vector<std::pair<const char*, double>>;

Timings time_all(const Model& model) {
  Problem problem(model);
  Timings timings;
  each_algorithm(problem, [&](const char* name, auto call) { timings.emplace_back(name, median_ns(SECONDS, call)); });
  return timings;
}

// ---- the fixed state ---------------------------------------------------------------------------------------------

struct Dof {
  std::string joint;
  bool has_q;  // false for a free joint, which has no coordinate per degree of freedom
  double q, qd, tau;
  double aba_local, aba_world, crba;  // three algorithms for the acceleration; their differences show the accuracy
};

// q_i = 0.3 + 0.1 i, qd_i = 0.5 - 0.05 i, tau_i = 1 - 0.2 i, with i the index of the degree of freedom from 0.
// A free joint is at the origin with zero rotation; its qd and tau follow the rule.
std::vector<Dof> fixed_state(const Model& model) {
  VectorXd q = pinocchio::neutral(model), v(model.nv), tau(model.nv);
  std::vector<Dof> dofs(model.nv);
  for (int j = 1; j < model.njoints; j++) {  // joint 0 is the universe
    const int nv = model.joints[j].nv(), nq = model.joints[j].nq(), first = model.joints[j].idx_v();
    const bool free = nv == 6 && nq == 7;
    if (!free && !(nv == 1 && nq == 1))
      throw std::runtime_error("joint " + model.names[j] + ": the fixed state has no rule for its type");
    for (int i = first; i < first + nv; i++) {
      v[i] = 0.5 - 0.05 * i;
      tau[i] = 1.0 - 0.2 * i;
      if (!free) q[model.joints[j].idx_q()] = 0.3 + 0.1 * i;
      dofs[i] = {model.names[j], !free, free ? 0.0 : 0.3 + 0.1 * i, v[i], tau[i], 0.0, 0.0, 0.0};
    }
  }

  Data data(model);
  const VectorXd local = pinocchio::aba(model, data, q, v, tau, Convention::LOCAL);
  const VectorXd world = pinocchio::aba(model, data, q, v, tau, Convention::WORLD);
  const VectorXd crba = crba_forward_dynamics(model, data, q, v, tau);
  // Loose, because long chains lose precision. It detects a wrong call of an algorithm and does not measure errors.
  const double scale = local.lpNorm<Eigen::Infinity>();
  const double spread = std::max((local - world).lpNorm<Eigen::Infinity>(), (local - crba).lpNorm<Eigen::Infinity>());
  if (!(spread <= 1e-6 * scale)) throw std::runtime_error("the three routes to the accelerations disagree");

  for (int i = 0; i < model.nv; i++) {
    dofs[i].aba_local = local[i];
    dofs[i].aba_world = world[i];
    dofs[i].crba = crba[i];
  }
  return dofs;
}

// ---- output ------------------------------------------------------------------------------------------------------

void print_accelerations_csv(const std::string& name, const std::vector<Dof>& dofs) {
  for (const Dof& d : dofs) {
    std::printf("%s,%s,", name.c_str(), d.joint.c_str());
    if (d.has_q) std::printf("%.17g", d.q);
    std::printf(",%.17g,%.17g,%.17g,%.17g,%.17g\n", d.qd, d.tau, d.aba_local, d.aba_world, d.crba);
  }
}

void print_timings_csv(const std::string& name, int nv, const Timings& timings, bool header) {
  if (header) {
    std::printf("model,nv");
    for (const auto& [algorithm, ns] : timings) std::printf(",%s", algorithm);
    std::printf("\n");
  }
  std::printf("%s,%d", name.c_str(), nv);
  for (const auto& [algorithm, ns] : timings) std::printf(",%.1f", ns);
  std::printf("\n");
}

// Names are from URDF files and compiler strings. A name with a quote or a backslash would
// make the JSON invalid, which its reader reports.
void print_json(const std::string& name, int nv, const Timings& timings, const std::vector<Dof>& dofs, bool first) {
  std::printf("%s\n  {\"model\": \"%s\", \"nv\": %d,\n   \"ns\": {", first ? "" : ",", name.c_str(), nv);
  const char* comma = "";
  for (const auto& [algorithm, ns] : timings) {
    std::printf("%s\"%s\": %.1f", comma, algorithm, ns);
    comma = ", ";
  }
  std::printf("},\n   \"accelerations\": [");
  comma = "";
  for (const Dof& d : dofs) {
    std::printf("%s%.17g", comma, d.aba_local);
    comma = ", ";
  }
  std::printf("]}");
}

// "some/where/chain_7.bin" -> "chain_7"
std::string model_name(const std::string& path) {
  const std::string file = path.substr(path.find_last_of('/') + 1);
  return file.substr(0, file.find_last_of('.'));
}

// Compiler and versions: the members of a JSON object.
void print_versions() {
  std::printf("\"compiler\": \"g++ %s\", \"flags\": \"%s\", \"pinocchio\": \"%s\", \"eigen\": \"%d.%d.%d\"", __VERSION__,
              COMPILE_FLAGS, PINOCCHIO_VERSION, EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION);
}

// Throws for an unknown algorithm.
double time_one(Problem& problem, const std::string& algorithm, double seconds) {
  double ns = NAN;
  each_algorithm(problem, [&](const char* name, auto call) {
    if (algorithm == name) ns = median_ns(seconds, call);
  });
  if (std::isnan(ns)) throw std::runtime_error("no algorithm " + algorithm);
  return ns;
}

// Answers lines until the end of the input.
void serve(const std::vector<std::string>& paths) {
  std::map<std::string, Problem> problems;
  for (const std::string& path : paths) {
    Model model;
    pinocchio::serialization::loadFromBinary(model, path);
    fixed_state(model);  // throws if the algorithms disagree
    problems.emplace(model_name(path), model);
  }
  std::printf("{");
  print_versions();
  std::printf("}\n");
  std::fflush(stdout);
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string model, algorithm, more;
    double seconds;
    if (!(words >> model >> algorithm >> seconds) || words >> more || !(seconds >= 0.0))
      throw std::runtime_error("expected MODEL ALGORITHM SECONDS, found: " + line);
    const auto found = problems.find(model);
    if (found == problems.end()) throw std::runtime_error("no model " + model + ": " + line);
    std::printf("%.2f\n", time_one(found->second, algorithm, seconds));
    std::fflush(stdout);
  }
}

int run(const std::string& mode, const std::vector<std::string>& paths) {
  if (mode == "--serve") {
    serve(paths);
    return EXIT_SUCCESS;
  }
  if (mode == "--json") {
    std::printf("{");
    print_versions();
    std::printf(", \"models\": [");
  } else if (mode == "--accelerations") {
    std::printf("model,joint,q,qd,tau,qdd_aba_local,qdd_aba_world,qdd_crba\n");
  }

  for (const std::string& path : paths) {
    const bool first = path == paths.front();
    const std::string name = model_name(path);
    Model model;
    pinocchio::serialization::loadFromBinary(model, path);
    const std::vector<Dof> dofs = fixed_state(model);
    if (mode == "--accelerations") {
      print_accelerations_csv(name, dofs);
      continue;
    }
    const Timings timings = time_all(model);
    if (mode == "--json")
      print_json(name, model.nv, timings, dofs, first);
    else
      print_timings_csv(name, model.nv, timings, first);
    std::fflush(stdout);
  }
  if (mode == "--json") std::printf("\n]}\n");
  return EXIT_SUCCESS;
}

int main(int argc, char** argv) {
  std::string mode = "--csv";
  std::vector<std::string> paths;
  for (int k = 1; k < argc; k++) {
    const std::string argument = argv[k];
    if (argument.rfind("--", 0) == 0)
      mode = argument;
    else
      paths.push_back(argument);
  }
  const bool known = mode == "--csv" || mode == "--json" || mode == "--accelerations" || mode == "--serve";
  if (!known || paths.empty()) {
    std::fprintf(stderr, "usage: pinocchio_bench [--csv | --json | --accelerations | --serve] MODEL.bin...\n");
    return 2;
  }
  try {
    return run(mode, paths);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "pinocchio_bench: %s\n", error.what());
    return EXIT_FAILURE;
  }
}
