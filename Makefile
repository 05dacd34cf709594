check:
	@rtest/setup/run_tests.sh $(FILES)
