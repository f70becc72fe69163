# The whole developer story. Each target is short and says what it proves.
RUN ?= uv run --extra all --group dev
TESTS ?=
CLAW_TORCH ?= torch==2.13.0
VECTORS ?= ../shared/data/vectors
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
# Programs that tests begin by the hundred read what the first of their kind has compiled.
unexport PYTHONDONTWRITEBYTECODE

# Every target is a verb, no file.
.PHONY: $(shell sed -n "s/^\([a-z-]*\):.*/\1/p" $(firstword $(MAKEFILE_LIST)))

check: lint types imports test  ## all of it; green before anything lands

fast:  ## while working, in at most 90 s: the tests of the packages that wait for nothing and take no second of their own
	@$(RUN) pytest -q -n 2 --dist loadgroup -m "not e2e and not real_time and not long" $(TESTS); echo "fast: $$SECONDS s of 90 s"

format:  ## rewrite to the one format
	$(RUN) ruff format .
	$(RUN) ruff check --fix-only .

lint:
	$(RUN) ruff format --check .
	$(RUN) ruff check .

types:
	$(RUN) mypy

imports:  ## who may import whom (one direction)
	$(RUN) lint-imports

test:
	$(RUN) pytest -q -n 4 --dist loadgroup $(TESTS)

docs:  ## regenerate the generated pages; a test fails while they differ
	$(RUN) python -m docs.generate

demo:
	$(RUN) ztpm demo

site:  ## the documentation site in build/site/html, from the pages and the code
	rm -rf build/site && mkdir -p build/site
	$(RUN) python -m docs.site build/site/pages
	cp docs/zensical.toml build/site/
	cd build/site && uv tool run -q --from zensical==0.0.73 --with mkdocstrings-python==2.0.11 zensical build --strict

bench:  ## capability tokens beside their peers, in one run; the ratios last
	uv run --extra all --extra bench --group dev ztpm eval bench capabilities

claw:  ## five requests to the four agents of examples/cobot_claw and one beyond what was lent, offline, in an environment of its own (2.8 GB); how many were as told last
	@[ -x .claw/bin/ztpm ] || { python3 -m venv .claw; .claw/bin/pip install -q $(CLAW_TORCH); .claw/bin/pip install -q -e '.[pep,idp,cli,otel]' -e examples/cobot_claw pytest pytest-timeout pytest-rerunfailures pytest-xdist hypothesis; }
	.claw/bin/python -m pytest -q -n 0 --campaign tests/examples
	.claw/bin/ztpm claw show --svg examples/cobot_claw/images/run.svg --picture examples/cobot_claw/images/handover.svg

campaign:  ## every claim about tokens, decisions, trust and behaviour, tried in full; the figures, and each defence taken out, last
	$(RUN) ztpm eval tokens $(if $(wildcard $(VECTORS)),--vectors $(VECTORS))
	$(RUN) python -m tests.model.campaign
	$(RUN) ztpm eval conduct
	$(RUN) pytest -q --campaign -m "campaign or hypothesis"

redteam:  ## every attack of evaluation/scenarios in every mode on running cells (hours); goes on where it was ended; the figures last
	uv run --extra all --extra bench --group dev ztpm eval redteam --ledger .redteam --out evaluation/results/redteam.json

coverage:  ## each cell of the paper's coverage table by taking primitives out of a running cell (long); goes on where it was ended; the figures last
	uv run --extra all --extra bench --group dev ztpm eval coverage --ledger .coverage-runs --out evaluation/results/coverage.json

soundness:  ## 20,000 motions, half of them lines, paths and streams, against MuJoCo, their certificates and corrupted ones; goes on where it was ended
	uv run --extra all --extra bench --group dev python -m tests.pep.pit.campaign --ledger .soundness

trajectories:  ## 10,000 timed trajectories alone, as `soundness` does; how far the index is above the samples and the figure last; goes on where it was ended
	uv run --extra all --extra bench --group dev python -m tests.pep.pit.campaign --trajectories --count 10000 --ledger .soundness
motions:  ## 10,000 paths with cut corners and 10,000 contacts and poses of streams against an arm of their own, every millisecond; the figures last (MINUTES ends it earlier)
	$(RUN) python -m tests.pep.pit.campaign.blends $(if $(MINUTES),--minutes $(MINUTES))
	$(RUN) python -m tests.pep.pit.campaign.contacts $(if $(MINUTES),--minutes $(MINUTES))

cells:  ## all that is tried of leased programs, latches and real cells on whole cells, in real time
	$(RUN) python -m pytest -q --campaign tests/e2e/led tests/e2e/programs tests/e2e/latch tests/e2e/arms tests/pep/test_cell.py tests/adapters tests/e2e/test_up.py

rtde-campaign:  ## a hostile program, deaths and revocations at the robot's ports: 20,000 sequences, 200 of each death, 10,000 clears; goes on where it was ended
	$(RUN) python -m tests.pep.rtde.campaign --ledger .rtde-campaign

boundary:  ## the gateway before servers that nobody changed; evidence changed at each await point, 300 changed definitions, requests that two readers read differently, 60 security cases; the figures last
	$(RUN) pytest -q --campaign tests/e2e/test_tool_gateway.py tests/e2e/test_stdio.py tests/e2e/test_clients.py
	$(RUN) python -m tests.pep.mcp.campaign

tampering:  ## 10,000 changed copies of a ledger before the holder of a checkpoint; how many were found last
	$(RUN) python -m tests.ztpm_idp.campaign.tampering

forgeries:  ## forged evidence of agents, each wrong in one way, at the wire of a provider; how many were accepted last
	$(RUN) python -m tests.ztpm_idp.platforms.forgeries

rotation:  ## a new key in every role under load, two providers and two enforcement points as processes; the figure last
	$(RUN) python -m tests.e2e.rotation_campaign

horizon:  ## 54 enforcement points, 10,000 live tokens, 200 revocations and 1,000 descendants; the time to the last permit last (DATABASE=URL for another database, ARGS="--postgres --workers 2" and the like)
	$(RUN) python -m tests.ztpm_idp.campaign.horizon $(if $(DATABASE),--database $(DATABASE)) $(ARGS)

pages:  ## first paint and weight of the pages people look at, pictures a second of 50 objects, CPU of ten viewers; the figures last
	$(RUN) python -m tests.e2e.live.figures

login:  ## a person logs in at the certified oidc-provider in Chromium and confirms a command line; where the pictures lie last
	@$(RUN) pytest -q -s --campaign tests/ztpm_idp/login/test_in_browser.py | awk '{ print; fflush() } /pictures in/ { last = $$0 } \
	  END { sub(/^[.]+/, "", last); print last; exit last == "" }'

oauth-conformance:  ## `conformance authorization` of the MCP suite against a provider of its own; needs npm; the figure last
	$(RUN) python -m tests.ztpm_idp.oauth.conformance

postgres:  ## the identity provider's tests over PostgreSQL: a real server, which a wheel brings
	@$(RUN) pytest -q -n 2 --dist loadgroup --postgres tests/ztpm_idp; echo "postgres: $$SECONDS s"

public-servers:  ## ten popular MCP servers as they were published behind one gateway, from npm and PyPI; how many are held, last
	$(RUN) python -m tests.e2e.public.servers

public-arms:  ## two public MCP servers for UR arms behind one gateway, each with a simulated controller; how many are held, last
	$(RUN) python -m tests.e2e.public.arms

store-faults:  ## kill -9 at every boundary of the store and at 300 instants, 1,000 rounds of 64 uses at once, on both databases; goes on where it was ended; the figures last
	$(RUN) python -m tests.ztpm_idp.store.campaign --ledger .store-faults

store-rollback:  ## 50 restores of an old copy beside points that are old, wiped or silent, on each database; what was known and lost last
	@for kind in "" --postgres; do $(RUN) pytest -q -s --campaign $$kind tests/pep/provider/test_restore_drill.py; done | awk \
	  '/restores:/ { sub(/^[.]+/, ""); restores += $$1; lost += $$3; known += $$5 } /passed|failed|^FAILED/ { print; fflush() } \
	  END { print restores " restores: " lost " of " known " known revocations lost"; exit !(restores >= 100 && lost == 0) }'

programs:  ## thirty small ur_rtde programs under `ztpm rtde run`, in ten minutes; how many ran, were refused clearly and failed, last
	$(RUN) ztpm eval programs

paper:  ## the paper's 60 traces, with no gate and before one, in a quarter of an hour; how many kept within their bound, last
	$(RUN) ztpm eval paper --out evaluation/results

mutants:  ## what the tests of the policies let live; the score last (half an hour)
	$(RUN) --with "mutmut>=3.8,<3.9" python -m tests.mutation

insecure-settings:  ## each insecure or empty setting of an identity provider keeps it from starting and is named; how many, last
	$(RUN) python -m tests.ztpm.point.test_insecure_settings

constraints:  ## pin the whole set with hashes, without naming an index
	uv pip compile pyproject.toml --all-extras --group dev --generate-hashes --no-emit-index-url --no-header --universal --python-version 3.11 -o constraints.txt -q

approval-defects:  ## D2: every defect of an approval alone and 300 pairs, at the gate; the figure last
	$(RUN) python -m tests.pep.people.campaign defects

approval-mutants:  ## D3: 500 changes of what was approved, and names that deceive; the figure last
	$(RUN) python -m tests.pep.people.campaign mutants

approval-storm:  ## D4: 10,000 asks by 20 agents in an hour; the figure last
	$(RUN) python -m tests.pep.people.campaign storm

routes:  ## every route of the identity provider against each kind of caller who must not be let in; cells and unexpected ones last
	$(RUN) python -m tests.ztpm_idp.hostile.matrix

store-errors:  ## every call of the store failing once under each command of the identity provider, on both databases; the figures last
	$(RUN) python -m tests.ztpm_idp.hostile.faults

hostile-api:  ## right and wrong requests of the whole API's description, from twelve roles, on both databases; requests and failures last
	$(RUN) python -m tests.ztpm_idp.hostile
