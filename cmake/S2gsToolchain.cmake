# Compiler settings shared by every target, and the two functions that declare targets.

add_library(s2gs_flags INTERFACE)
target_include_directories(s2gs_flags INTERFACE "${PROJECT_SOURCE_DIR}")
target_compile_options(s2gs_flags INTERFACE
  $<$<COMPILE_LANGUAGE:CXX>:-Wall -Wextra -Wshadow -Wno-unknown-pragmas>
  # One rounding rule for every thread count and build: no reassociation, no contraction across statements.
  $<$<COMPILE_LANGUAGE:CXX>:-fno-math-errno -ffp-contract=on>)

if(S2GS_SANITIZE)
  target_compile_options(s2gs_flags INTERFACE
    $<$<COMPILE_LANGUAGE:CXX>:-fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer>)
  target_link_options(s2gs_flags INTERFACE -fsanitize=address,undefined)
  # libstdc++'s own bounds checks on [] and iterators.
  target_compile_definitions(s2gs_flags INTERFACE $<$<COMPILE_LANGUAGE:CXX>:_GLIBCXX_ASSERTIONS>)
endif()

if(S2GS_FUZZ)
  # Coverage for libFuzzer in every library; the fuzz programs alone link its main.
  target_compile_options(s2gs_flags INTERFACE $<$<COMPILE_LANGUAGE:CXX>:-fsanitize=fuzzer-no-link>)
endif()

find_program(S2GS_CCACHE ccache)
if(S2GS_CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${S2GS_CCACHE}")
  set(CMAKE_CUDA_COMPILER_LAUNCHER "${S2GS_CCACHE}")
endif()

if(S2GS_TIDY)
  find_program(S2GS_CLANG_TIDY clang-tidy REQUIRED)
  set(CMAKE_CXX_CLANG_TIDY "${S2GS_CLANG_TIDY};--warnings-as-errors=*;--quiet")
endif()

# s2gs_library(NAME SOURCES ... LINK ...)
function(s2gs_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINK" ${ARGN})
  add_library(${name} STATIC ${ARG_SOURCES})
  target_link_libraries(${name} PUBLIC s2gs_flags ${ARG_LINK})
endfunction()

# s2gs_test(NAME SOURCES ... LINK ...): one GoogleTest program, each of its tests known to ctest.
function(s2gs_test name)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE s2gs_flags ${ARG_LINK} GTest::gmock GTest::gtest_main)
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 60 PROPERTIES TIMEOUT 300)
endfunction()
