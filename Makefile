# anmech: analytical mechanics in Maxima.  "make" alone says what there is.  The work is done by the scripts of rtest/setup.

MAXIMA ?= maxima
export MAXIMA
setup = rtest/setup

help:
	@echo "make demo         the demonstration: its results here, its pictures in out/ (seconds)"
	@echo "make check        all tests, on the Maxima at hand (a quarter of an hour on two processors);"
	@echo "                  some of them: make check FILES=\"rtest_ch14 rtest_motion\""
	@echo "make check-all    tests, examples and installation on Maxima 5.46 with GCL and SBCL, and on 5.50 with ECL"
	@echo "                  (forty minutes on two processors; the others are fetched and built into ~/.cache/anmech: 1.3 GB)"
	@echo "make check-gui    the worksheets, in wxMaxima on a display that nobody sees (half an hour; installs wxMaxima)"
	@echo "make check-sweeps sweeps whose workers are killed, whose disk is full, whose hosts vanish; Slurm (minutes)"
	@echo "make check-packages  what make dist and make deb make, used and removed again (minutes; installs lintian)"
	@echo "make coverage     the functions that no test calls"
	@echo "make bench        measurements"
	@echo "make doc          the manual, as Maxima reads it, and in doc/ as HTML and PDF"
	@echo "make gallery      the pictures of README.md"
	@echo "make house        the plan of the files, into CONTRIBUTING.md and as a picture"
	@echo "make install      for you alone; then load(\"anmech\") works in every Maxima (half a minute)"
	@echo "make uninstall    the reverse"
	@echo "make dist         the project as tar files, into out/"
	@echo "make deb          a package of Debian, into out/"
	@echo "make clean        removes out/, the compiled kernel, and the Maximas of check-all"
	@echo
	@echo "What is missing is installed on Debian and Ubuntu (as root, or with sudo that asks for no password)."
	@echo "Another Maxima:   make check MAXIMA=\"maxima -l sbcl\"        Time limit in seconds: TIMEOUT=60"

demo: ready
	@$(setup)/run_examples.sh examples/demo.mac

check: ready
	@$(setup)/run_tests.sh $(FILES)

check-all: ready
	@$(setup)/check_all.sh $(FILES)

check-gui: ready
	@$(setup)/check_gui.sh $(FILES)

check-sweeps: ready
	@$(setup)/check_sweeps.sh $(FILES)

check-packages: ready
	@$(setup)/check_packages.sh

coverage: ready
	@$(setup)/coverage.sh $(FILES)

bench: ready
	@for script in bench/*.sh; do [ ! -x "$$script" ] || "$$script" || exit 1; done

gallery: ready
	@$(setup)/draw_gallery.sh

doc: ready
	@$(setup)/build_manual.sh

house: ready
	@$(setup)/draw_house.sh

install:
	@$(setup)/install.sh

uninstall:
	@$(setup)/install.sh --remove

dist:
	@$(setup)/build_dist.sh

deb: ready
	@$(setup)/build_deb.sh

clean:
	rm -rf out "$${XDG_CACHE_HOME:-$$HOME/.cache}/anmech"

ready:
	@$(setup)/install_maxima.sh

.PHONY: help demo check check-all check-gui check-sweeps check-packages coverage bench gallery doc house install uninstall dist deb \
  clean ready
