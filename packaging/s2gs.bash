# bash completion for s2gs: its commands and their options, as its own help lists them.
_s2gs() {
  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]} program=${COMP_WORDS[0]} choices
  COMPREPLY=()
  if [[ $COMP_CWORD -eq 1 || ($COMP_CWORD -eq 2 && $before == help) ]]; then
    choices=$("$program" help 2>/dev/null | sed -n '/^Commands:/,/^$/s/^  \([a-z0-9_]*\) .*/\1/p')
    mapfile -t COMPREPLY < <(compgen -W "$choices" -- "$word")
  elif [[ $word == -* ]]; then
    choices=$("$program" "${COMP_WORDS[1]}" --help 2>/dev/null | sed -n 's/^  \(--[A-Za-z0-9_.]*\) .*/\1/p')
    mapfile -t COMPREPLY < <(compgen -W "$choices --help" -- "$word")
  elif [[ $before == -h || $before == --help ]]; then
    choices=$("$program" "${COMP_WORDS[1]}" -h 2>/dev/null | sed -n '/^Groups /,$s/^  \([A-Za-z]*\) .*/\1/p')
    mapfile -t COMPREPLY < <(compgen -W "$choices" -- "$word")
  else
    # The values that an option's help lists after "one of".
    choices=$("$program" "${COMP_WORDS[1]}" --help 2>/dev/null | awk -v option="$before" '
      $1 == option { found = 1; text = $0; next }
      found && /^(  -|$)/ { exit }
      found { text = text " " $0 }
      END { gsub(/ +/, " ", text); if (match(text, /one of [^:;(]*/)) { list = substr(text, RSTART + 7, RLENGTH - 7); gsub(/,/, " ", list); print list } }')
    if [[ -n $choices ]]; then
      mapfile -t COMPREPLY < <(compgen -W "$choices" -- "$word")
    else
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -f -- "$word")
    fi
  fi
}
complete -F _s2gs s2gs
