# Commands of the project. Start with `make report` and `make test`.
#
#   make report [ROBOT=some.urdf] [OUT=report]   build, install into .venv, and write a report
#   make test      Rust tests, then the Python tests against the built wheel
#   make dev       debug build with fewer kernels in .venv-dev, for development (.venv-dev/bin/python, or -m pytest tests/python)
#   make test-jax  the tests of phipsi.jax, and its page, in .venv-jax (two minutes)
#   make test-optional   the tests that need PyTorch, Polars, PyArrow, xarray, Astropy, rosbags, NVRTC, Drake or dynibo, in .venv-optional (8 GB, of
#                  which the libraries of CUDA that PyTorch requires take half)
#   make docs      the pages of docs/ as a site, target/site/index.html, in .venv-docs; warnings are errors
#   make check     further checks of CI: format, clippy (including benches and generated Rust code), docs, stubs, abi3
#   make manylinux    Linux: the wheel for make test, linked by zig, so that it runs on glibc 2.17
#   make sdist     the source distribution and its content; make sdist-compiles: it and the packaged crate compile
#   make oldest    the wheel in Python 3.10 with the oldest NumPy and test packages it allows
#   make peers     install the peers, and build Pinocchio's C++ harness (Debian: apt-get, as root)
#   make stub      after make test: copies the docstrings of the compiled module into the stub
#   make instructions   counts instructions with valgrind, fails if an algorithm needs more than before
#   make auto-states  time of form auto by kind of state: writes docs/measured/auto-states.md (two minutes)
#   make derivatives  after make test: times of derivatives, compared with Pinocchio: writes docs/measured/derivative-times.md (a minute)
#   make kinematics  after make test: times of kinematics from Python, compared with Pinocchio: writes their section of docs/measured/benchmarks.md and README.md (a minute)
#   make leaving-out   instructions saved by each simplification, counted with valgrind: writes the table of docs/leaving-out.md
#   make numerics  after make peers: errors on extreme scenes, compared with the peers: writes docs/measured/numerics.md, its plots and the results in README.md (ten minutes)
#   make motion [OUT=report]   after make peers: study of integrators, compared with the peers (some minutes)
#   make robustness  after make test: completed simulations, their errors, energy and times, compared with MuJoCo: writes docs/measured/motion-robustness.md (ten minutes)
#   make optimal-control      optimal control, compared with Crocoddyl, in .venv-crocoddyl: writes docs/measured/optimal-control.md (three minutes)
#   make inverse-kinematics   inverse kinematics, compared with pink, mink and dynibo, in .venv-ik: writes docs/measured/inverse-kinematics-times.md (ten minutes)
#   make loops-and-contacts  steps of closed loops compared with the tree, of a standing robot with MuJoCo: writes docs/measured/loops-and-contacts.md (a minute)
#   make jax-calls      one call from a jitted program of JAX, through Python and as an operation of XLA: writes docs/measured/jax-calls.md
#   make populations   a model for each state: writes docs/measured/populations.md (a minute)
#   make servos         steps of servos at their limits, environments, and random servos: writes docs/measured/servos.md (two minutes)
#   make closed-loops   forward dynamics with connections, compared with Pinocchio: writes docs/measured/closed-loops-times.md (a minute)
#   make contact-suites   after make test: contacts in SimBenchmark and ContactBench, compared with MuJoCo: writes docs/measured/contact-suites.md (ten minutes)
#   make compiled  after make peers: compiled robots, compared with the methods of the scene and with CasADi's code: writes docs/measured/compiled-times.md (some minutes)
#   make embedded  after make test: flash, stack and instructions of robots on a Cortex-M4F, by gcc-arm-none-eabi and QEMU: writes docs/measured/embedded-size.md (half a minute)
#   make rust-crate   build time and size of a Rust program that uses the crate, by features: writes docs/measured/rust-crate.md (ten minutes)
#   make build-budget  CPU time of the build of the Python module, and its code by feature, instruction set and function: writes docs/measured/build-budget.md (fifteen minutes)
#   make picture   the pictures of README.md and of docs/examples.md (some minutes)
#   make roofline  after make peers for its robots: operations, time and fraction of the machine's peak: writes docs/measured/roofline.md
#   make bench     after make peers: all benchmarks (20 minutes): writes docs/measured/benchmarks.md and the results in README.md (BENCH=--quick: a test)

comma := ,
PYTHON ?= python3
# The first of these that is executable.
PYTHON_3_10 ?= python3.10 $(wildcard $(HOME)/.pyenv/versions/3.10.*/bin/python)
OUT ?= report
ROBOT ?=
BENCH ?=
ROOFLINE ?=
STUDY ?=
# Kernels for AVX-512 take half of the compile time. A build for this machine alone omits them if its processor lacks AVX-512
# (on an aarch64 machine they do not exist); release wheels (make manylinux) and make check have all kernels.
AVX512 := $(if $(shell grep -m1 -w avx512vl /proc/cpuinfo 2>/dev/null || sysctl -n hw.optional.avx512vl 2>/dev/null | grep -w 1),$(comma)avx512)
# Rust tests without Python.
FEATURES := collision,urdf,parallel,dense,stochastic$(AVX512)
ALL_FEATURES := collision,urdf,parallel,dense,stochastic,avx512
VENV := .venv
BIN := $(VENV)/bin
PEERS := .venv-peers/bin/python
WHEELS := target/wheels
SOURCES := Cargo.toml Cargo.lock pyproject.toml PACKAGE.md README.md $(shell find src python assets -type f -not -name '*.pyc')

.PHONY: dev report test test-rust test-python test-jax test-optional docs check check-crate check-wheel manylinux sdist sdist-compiles oldest bench numerics motion robustness instructions auto-states derivatives kinematics leaving-out inverse-kinematics closed-loops loops-and-contacts optimal-control servos populations jax-calls contact-suites compiled embedded roofline rust-crate build-budget picture peers peers-there peers-phipsi stub clean

# A separate environment; the packages of the system are not changed.
$(BIN)/python:
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 10), "Python >= 3.10 is needed, this is " + sys.version'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip 'maturin>=1.9.4,<2'

# Further arguments of maturin; make manylinux replaces them.
WHEEL_FLAGS ?= --features python$(AVX512)
$(VENV)/wheel: $(SOURCES) | $(BIN)/python
	rm -rf $(WHEELS)
	$(BIN)/maturin build --release --locked --quiet $(WHEEL_FLAGS) --out $(WHEELS)
	$(BIN)/python -m pip install --quiet --force-reinstall --no-deps $(WHEELS)/phipsi-*.whl
	touch $@

$(VENV)/report: $(VENV)/wheel pyproject.toml
	$(BIN)/python -m pip install --quiet "$$(ls $(WHEELS)/phipsi-*.whl)[report,view]"
	touch $@

$(VENV)/test: $(VENV)/wheel pyproject.toml
	$(BIN)/python -m pip install --quiet "$$(ls $(WHEELS)/phipsi-*.whl)[test]"
	touch $@

report: $(VENV)/report
	$(BIN)/phipsi report $(ROBOT) -o $(OUT)
	@echo "open $(OUT)/index.html"

test: test-rust test-python

# Without incremental compilation, which takes a quarter of the disk space.
test-rust:
	CARGO_INCREMENTAL=0 cargo test --locked --features $(FEATURES)

DEV := .venv-dev
$(DEV)/bin/python:
	$(PYTHON) -m venv $(DEV)
	$(DEV)/bin/python -m pip install --quiet numpy pytest hypothesis mpmath scipy matplotlib plotly rich click jinja2
	echo "$(CURDIR)/python" > "$$($(DEV)/bin/python -c 'import site; print(site.getsitepackages()[0])')/phipsi-dev.pth"

dev: | $(DEV)/bin/python
	cargo rustc --locked --lib --crate-type cdylib --features python
	cp target/debug/libphipsi.so python/phipsi/_core.abi3.so || cp target/debug/libphipsi.dylib python/phipsi/_core.abi3.so
	$(DEV)/bin/python -c 'import phipsi; print("phipsi", phipsi.__version__, "from", phipsi.__file__)'

# From another folder, so that the installed wheel is imported and not the source.
test-python: $(VENV)/test
	cd tests/python && ../../$(BIN)/python -m pytest -q --durations=40 --rootdir . -c ../../pyproject.toml .

# JAX starts threads, with which other tests must not fork: a separate environment.
$(VENV)-jax/there: $(VENV)/wheel pyproject.toml
	$(PYTHON) -m venv $(VENV)-jax
	$(VENV)-jax/bin/python -m pip install --quiet "$$(ls $(WHEELS)/phipsi-*.whl)[jax]" 'pytest>=8'
	touch $@

test-jax: $(VENV)-jax/there
	cd tests/python && ../../$(VENV)-jax/bin/python -m pytest -q --rootdir . -c ../../pyproject.toml test_jax.py 'test_docs.py::test_python_blocks_run[docs/how-to/jax.md]'

# The package index has PyTorch for Linux on x86_64 with CUDA only, which takes 5 GB and two minutes; without its libraries it cannot be imported.
# No cache, which would take half of that again. The versions of the peers are those of the benchmarks.
$(VENV)-optional/there: $(VENV)/wheel pyproject.toml benches/peers/requirements.txt
	$(PYTHON) -m venv $(VENV)-optional
	$(VENV)-optional/bin/python -m pip install --quiet --no-cache-dir -c benches/peers/requirements.txt "$$(ls $(WHEELS)/phipsi-*.whl)[torch,logs,mujoco,report]" 'pytest>=8' \
	  hypothesis mpmath scipy matplotlib pandas pin example-robot-data drake dynibo pyarrow xarray astropy "nvidia-cuda-nvrtc-cu12; sys_platform == 'linux'"
	touch $@

test-optional: $(VENV)-optional/there
	cd tests/python && ../../$(VENV)-optional/bin/python -m pytest -q --rootdir . -c ../../pyproject.toml \
	  test_torch.py test_logs.py test_labels.py test_stability_peers.py test_codegen_cuda.py \
	  'test_docs.py::test_python_blocks_run[docs/how-to/pytorch.md]' 'test_docs.py::test_python_blocks_run[docs/coming-from/drake.md]'

# The wheel is needed to run the notebooks; the reference is read from the sources.
$(VENV)-docs/there: $(VENV)/wheel pyproject.toml
	$(PYTHON) -m venv $(VENV)-docs
	$(VENV)-docs/bin/python -m pip install --quiet "$$(ls $(WHEELS)/phipsi-*.whl)[docs]"
	$(VENV)-docs/bin/python -m pip install --quiet --force-reinstall --no-deps $(WHEELS)/phipsi-*.whl
	touch $@

docs: $(VENV)-docs/there
	NO_MKDOCS_2_WARNING=1 $(VENV)-docs/bin/mkdocs build --strict
	@echo "open target/site/index.html"

# The short examples of docs/examples.md.
EXAMPLES := $(patsubst %,python/phipsi/examples/%.py,ant computed_torque dropped_box follow four_bar go2 gripper humanoid inverse_kinematics lift lqr own_urdf panda quadruped stand_up talos xacro_snake)

# Another processor architecture: its kernels are compiled, but not run.
OTHER := aarch64-unknown-linux-gnu

# The oldest Rust that Cargo.toml allows; clippy knows the version of each function of std, but not of the language.
OLDEST_RUST := $(shell sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)

check: check-crate check-wheel

# Without the Python module, the feature python has all code of the others; what is dead without it is found in the library.
check-crate: export CARGO_INCREMENTAL = 0
check-crate:
	cargo fmt --check
	cargo clippy --locked --all-targets --no-default-features -- -D warnings
	cargo clippy --locked --lib --features $(ALL_FEATURES) -- -D warnings
	cargo clippy --locked --all-targets --features python,avx512 -- -D warnings
	if rustup toolchain install $(OLDEST_RUST) --profile minimal --no-self-update; then \
	  cargo +$(OLDEST_RUST) check --locked --lib --features $(ALL_FEATURES) || exit 1; \
	else echo "Rust $(OLDEST_RUST): not checked: rustup cannot install it here"; fi
	if rustup target add $(OTHER); then cargo clippy --locked --lib --features $(ALL_FEATURES) --target $(OTHER) -- -D warnings; \
	else echo "$(OTHER): not checked: rustup does not support it here"; fi
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --features $(ALL_FEATURES)
	CARGO_TARGET_DIR=target cargo run --manifest-path examples/build_script/Cargo.toml

check-wheel: $(VENV)/test
	$(BIN)/phipsi codegen -o target/codegen --lang rust --name bundled
	cargo clippy --manifest-path target/codegen/Cargo.toml --all-targets -- -D warnings
	$(BIN)/python -m pip install --quiet 'mypy>=1.15' 'abi3audit>=0.0.20'
# Names of other libraries exist for their errors only.
	$(BIN)/python -c 'from phipsi._glossary import HINTS; print(*(f"phipsi._core.Scene.{name}" for name in ("__new__", *HINTS)), sep="\n")' > target/elsewhere
	cd tests/python && ../../$(BIN)/python -m mypy.stubtest --allowlist ../../target/elsewhere phipsi._core
	$(BIN)/mypy python/phipsi
	$(BIN)/mypy --strict $(EXAMPLES)
	$(BIN)/abi3audit --strict $(WHEELS)/phipsi-*.whl

# Run before make test, which then uses this wheel. zig is installed from the package index; maturin finds it with the python3 of PATH.
manylinux: | $(BIN)/python
	$(BIN)/python -m pip install --quiet 'ziglang>=0.14' 'auditwheel>=6'
	test -f $(WHEELS)/phipsi-*manylinux_2_17_*.whl || rm -f $(VENV)/wheel
	PATH="$(CURDIR)/$(BIN):$$PATH" $(MAKE) $(VENV)/wheel WHEEL_FLAGS='--features python$(comma)avx512 --zig --compatibility manylinux_2_17 --compression-level 9'
	$(BIN)/auditwheel show $(WHEELS)/phipsi-*.whl
	ls -l $(WHEELS)/phipsi-*manylinux_2_17_*.whl

SDIST := target/sdist
sdist: | $(BIN)/python
	rm -rf $(SDIST)
	$(BIN)/maturin sdist --out $(SDIST)
	$(BIN)/python .ci/check_sdist.py $(SDIST)/phipsi-*.tar.gz

# Uses the compiled dependencies of make check. The files of the package are those of the source distribution.
sdist-compiles: sdist
	cd $(SDIST)/phipsi-*/ && CARGO_TARGET_DIR="$(CURDIR)/target" cargo check --locked --features python,avx512
	cargo package --locked --allow-dirty --no-verify

# The tests are those of the source distribution.
oldest: $(VENV)/wheel sdist
	@for python in $(PYTHON_3_10); do \
	  if "$$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 10))' 2>/dev/null; then \
	    "$$python" .ci/test_wheel.py --oldest --tree $(SDIST)/phipsi-*/ $(WHEELS)/phipsi-*.whl; exit; \
	  fi; \
	done; echo "make oldest: skipped: found no Python 3.10 (python3.10 or ~/.pyenv/versions)"

stub: $(VENV)/test
	cd tests/python && ../../$(BIN)/python stub_docs.py ../../python/phipsi/_core.pyi

# phipsi is installed in the environment of the peers, because all are measured in one process.
peers-phipsi: peers-there $(VENV)/wheel
	$(PEERS) -m pip install --quiet --force-reinstall --no-deps $(WHEELS)/phipsi-*.whl
	$(PEERS) -m pip install --quiet "$$(ls $(WHEELS)/phipsi-*.whl)[report,motion]" 'matplotlib>=3.7'

bench: peers-phipsi
	$(PEERS) benches/report.py $(BENCH)
	$(PEERS) benches/readme.py

# STUDY=--quick: fewer states and steps, as a test.
numerics: peers-phipsi
	$(PEERS) benches/study.py stability --markdown docs/measured/numerics.md $(STUDY)
	$(PEERS) benches/readme.py

motion: peers-phipsi
	$(PEERS) benches/study.py motion -o $(OUT) $(STUDY)

robustness: $(VENV)/test
	$(BIN)/python benches/motion_robustness.py --markdown docs/measured/motion-robustness.md

# Builds the bench, runs it under valgrind, compares with benches/instructions/expected.json.
instructions:
	$(PYTHON) benches/instructions/count.py

derivatives: $(VENV)/test
	$(BIN)/python benches/derivatives.py --markdown docs/measured/derivative-times.md

kinematics: $(VENV)/test
	$(BIN)/python benches/kinematics.py --page docs/measured/benchmarks.md
	$(BIN)/python benches/readme.py

$(VENV)-ik/there: $(VENV)/wheel
	$(PYTHON) -m venv $(VENV)-ik
	$(VENV)-ik/bin/python -m pip install --quiet 'pin>=3' 'pin-pink>=4' 'mink>=1' 'dynibo==0.5.2' 'qpsolvers[daqp]' 'example-robot-data>=4'
	$(VENV)-ik/bin/python -m pip install --quiet --force-reinstall --no-deps $(WHEELS)/phipsi-*.whl
	touch $@

inverse-kinematics: $(VENV)-ik/there
	$(VENV)-ik/bin/python benches/inverse_kinematics.py --markdown docs/measured/inverse-kinematics-times.md

closed-loops: $(VENV)/test
	$(BIN)/python benches/closed_loops.py --markdown docs/measured/closed-loops-times.md

contact-suites: $(VENV)/test
	$(BIN)/python benches/contact_suites.py --markdown docs/measured/contact-suites.md

loops-and-contacts: $(VENV)/test
	$(BIN)/python benches/loops_and_contacts.py --markdown docs/measured/loops-and-contacts.md

jax-calls: $(VENV)-jax/there
	$(VENV)-jax/bin/python benches/jax_calls.py --markdown docs/measured/jax-calls.md

populations: $(VENV)/test
	$(BIN)/python benches/populations.py --markdown docs/measured/populations.md

# Crocoddyl's wheel is built with Pinocchio 4.0.
optimal-control: $(VENV)/wheel
	python3 -m venv $(VENV)-crocoddyl
	$(VENV)-crocoddyl/bin/pip install --quiet crocoddyl==3.2.1 pin==4.0.0 example-robot-data mpmath numpy
	$(VENV)-crocoddyl/bin/pip install --quiet --force-reinstall --no-deps $(WHEELS)/phipsi-*.whl
	$(VENV)-crocoddyl/bin/python benches/optimal_control.py --markdown docs/measured/optimal-control.md

servos: $(VENV)/test
	$(BIN)/python benches/servos.py --markdown docs/measured/servos.md

compiled: peers-phipsi
	$(PEERS) benches/compiled.py --markdown docs/measured/compiled-times.md

embedded: $(VENV)/test
	$(BIN)/python benches/embedded.py --markdown docs/measured/embedded-size.md

rust-crate:
	$(PYTHON) benches/rust_crate.py --markdown docs/measured/rust-crate.md

build-budget:
	$(PYTHON) benches/build_budget.py --features python$(AVX512) --markdown docs/measured/build-budget.md

leaving-out:
	$(PYTHON) benches/leaving_out.py

auto-states: $(VENV)/test
	$(BIN)/python benches/auto_states.py --markdown docs/measured/auto-states.md

# ROOFLINE=--write-only: rewrite the page from the last measurement.
# Needs Chromium.
picture: $(VENV)/test
	$(BIN)/python docs/picture.py

roofline: $(VENV)/report
	$(BIN)/python -m pip install --quiet 'matplotlib>=3.7'
	$(BIN)/python benches/roofline.py $(ROOFLINE)

peers-there:
	@test -x $(PEERS) -a -x target/peers/pinocchio_bench || { echo "make bench: found no peers; run make peers first"; exit 1; }

peers:
	bash benches/peers/install.sh

clean:
	rm -rf target $(VENV) $(VENV)-jax $(VENV)-optional $(VENV)-docs $(VENV)-ik $(DEV) report python/phipsi/_core.abi3.so
