# cmake -DPROGRAM=s2gs -DOUTPUT=s2gs.1 -DVERSION=1.0 -P man_page.cmake: the manual page from what `-h` prints for the program
# and `--help`, with all options, for each of its commands.

# Text as roff shows it, line by line.
function(roff text result)
  string(REPLACE "\\" "\\e" text "${text}")
  string(REPLACE "-" "\\-" text "${text}")
  # A point or an apostrophe at a line's beginning would be a command.
  string(REGEX REPLACE "(^|\n)([.'])" "\\1\\\\&\\2" text "${text}")
  set(${result} "${text}" PARENT_SCOPE)
endfunction()

function(help result)
  execute_process(COMMAND "${PROGRAM}" ${ARGN} OUTPUT_VARIABLE text RESULT_VARIABLE code)
  if(NOT code EQUAL 0)
    message(FATAL_ERROR "${PROGRAM} ${ARGN} ended with ${code}")
  endif()
  set(${result} "${text}" PARENT_SCOPE)
endfunction()

help(program -h)
if(NOT program MATCHES "\nCommands:\n(.*)\n\nExit codes:\n(.*)$")
  message(FATAL_ERROR "`${PROGRAM} -h` lists no commands and exit codes")
endif()
set(list "${CMAKE_MATCH_1}")
set(codes "${CMAKE_MATCH_2}")
roff("${list}" commands)
roff("${codes}" exit_codes)
set(page ".TH S2GS 1 \"\" \"s2gs ${VERSION}\" \"User commands\"
.SH NAME
s2gs \\- turntable scans for COLMAP: photos to poses, splats, masks and mesh
.SH SYNOPSIS
.B s2gs
.I COMMAND
[\\fB\\-\\-OPTION\\fR \\fIVALUE\\fR]...
.br
.B s2gs
.I COMMAND
.B \\-h
[\\fIGROUP\\fR]
.br
.B s2gs
.I COMMAND
.B \\-\\-help
.SH COMMANDS
.nf
${commands}
.fi
.SH EXIT STATUS
.nf
${exit_codes}
.fi
")
string(REGEX MATCHALL "\n  [a-z0-9_]+  " names "\n${list}")
foreach(name IN LISTS names)
  string(STRIP "${name}" name)
  if(name STREQUAL "help")
    continue()
  endif()
  help(text ${name} --help)
  roff("${text}" text)
  string(TOUPPER "${name}" title)
  string(APPEND page ".SH ${title}\n.nf\n${text}.fi\n")
endforeach()
string(APPEND page ".SH SEE ALSO\n.BR colmap (1)\n")
file(WRITE "${OUTPUT}" "${page}")
