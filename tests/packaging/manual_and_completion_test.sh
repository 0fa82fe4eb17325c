#!/usr/bin/env bash
# usage: manual_and_completion_test.sh S2GS MANUAL_PAGE COMPLETION
# What is completed is known to each command's parser and stands in the manual page.
set -euo pipefail
s2gs=$1 page=$2
PATH=$(dirname "$s2gs"):$PATH
source "$3"

fail() { echo "$*" >&2; exit 1; }
completed() {
  COMP_WORDS=("$@")
  COMP_CWORD=$(($# - 1))
  _s2gs
  printf '%s\n' "${COMPREPLY[@]}"
}

commands=$(completed s2gs "")
[ "$(wc -l <<< "$commands")" -ge 14 ] || fail "commands: $commands"
for command in $commands; do
  [ "$command" != help ] || continue
  grep -q "^\.SH ${command^^}$" "$page" || fail "the manual page has no part $command"
  options=$(completed s2gs "$command" --)
  grep -q '^--log_level$' <<< "$options" || fail "$command: --log_level is not completed"
  for option in $options; do
    [ "$option" = --help ] || grep -qF -- "${option//-/\\-}" "$page" || fail "the manual page lacks $option of $command"
  done
  # A known option without a value is refused for that; an unknown one for its name.
  for option in $(awk 'NR % 10 == 1' <<< "$options"); do
    message=$("$s2gs" "$command" "$option" 2>&1 || true)
    ! grep -q "unknown option" <<< "$message" || fail "$command has no $option: $message"
  done
done
grep -qx -- --Train.max_seconds <<< "$(completed s2gs gaussian_trainer --Train.)" || fail "options of groups are not completed"
[ "$(completed s2gs gaussian_trainer -h T)" = Train ] || fail "names of groups are not completed"
[ "$(completed s2gs gaussian_trainer --Init.init s)" = sparse ] || fail "values of a group's option are not completed"
[ "$(completed s2gs automatic_scanner --until m)" = mesh ] || fail "values are not completed"
grep -q high <<< "$(completed s2gs automatic_scanner --quality "")" || fail "values of a long help are not completed"
[ "$(completed s2gs scan_b)" = scan_batch ] || fail "scan_batch is not completed"
# Roff takes no line of the help for a command of its own.
! grep -vE "^\.(TH|SH|B|I|br|nf|fi|BR)( |$)" "$page" | grep -qE "^[.']" || fail "a line of the help is lost"
