# Every package the project uses, and what to install when one is missing.

set(CMAKE_THREAD_PREFER_PTHREAD ON)
find_package(Threads REQUIRED)
find_package(OpenMP REQUIRED COMPONENTS CXX)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)             # libeigen3-dev
find_package(nlohmann_json 3.11 REQUIRED)               # nlohmann-json3-dev
find_package(CLI11 2.1 REQUIRED)                        # libcli11-dev
find_package(fmt REQUIRED)                              # libfmt-dev (with libspdlog-dev)
find_package(spdlog REQUIRED)                           # libspdlog-dev
if(NOT S2GS_SFM)
  # One binary for bare nodes: only the system's own libraries stay shared.
  set(CMAKE_FIND_LIBRARY_SUFFIXES .a ${CMAKE_FIND_LIBRARY_SUFFIXES})
endif()
find_package(JPEG REQUIRED)                             # libjpeg62-turbo-dev
find_package(PNG REQUIRED)                              # libpng-dev

# Header-only logging: no shared spdlog or fmt in the closure.
add_library(s2gs_logging INTERFACE)
target_link_libraries(s2gs_logging INTERFACE fmt::fmt-header-only Threads::Threads)
target_compile_definitions(s2gs_logging INTERFACE SPDLOG_FMT_EXTERNAL)

if(S2GS_SFM)
  find_package(Ceres 2.1 REQUIRED)                      # libceres-dev
  find_package(SQLite3 REQUIRED)                        # libsqlite3-dev
  find_package(Ceres 2.1 REQUIRED)                      # libceres-dev
endif()

if(S2GS_TESTS)
  find_package(GTest REQUIRED)                          # libgtest-dev libgmock-dev
endif()

# --- CUDA --------------------------------------------------------------------------------------------------
set(S2GS_HAS_CUDA OFF)
if(NOT S2GS_CUDA STREQUAL "OFF")
  include(CheckLanguage)
  check_language(CUDA)
  if(CMAKE_CUDA_COMPILER)
    if(NOT DEFINED CMAKE_CUDA_ARCHITECTURES)
      # Machine code for the data-centre and desktop chips in use, PTX for what comes after.
      set(CMAKE_CUDA_ARCHITECTURES 80-real 86-real 89-real 90-real 100-real 120-virtual)
    endif()
    enable_language(CUDA)
    set(CMAKE_CUDA_STANDARD 17)
    set(CMAKE_CUDA_STANDARD_REQUIRED ON)
    set(CMAKE_CUDA_RUNTIME_LIBRARY Static)
    find_package(CUDAToolkit 12 REQUIRED)
    set(S2GS_HAS_CUDA ON)
    message(STATUS "CUDA backend: ON (toolkit ${CUDAToolkit_VERSION}, architectures ${CMAKE_CUDA_ARCHITECTURES})")
  elseif(S2GS_CUDA STREQUAL "ON")
    message(FATAL_ERROR "S2GS_CUDA=ON, but no CUDA compiler was found. Install the CUDA Toolkit 12 or newer and "
                        "put nvcc on PATH (or set CUDACXX), or configure with -DS2GS_CUDA=OFF.")
  endif()
endif()
if(NOT S2GS_HAS_CUDA)
  message(WARNING "CUDA backend: OFF. Training will run on the CPU, about two orders of magnitude slower than on "
                  "a GPU. Install the CUDA Toolkit 12 or newer for the GPU backend.")
endif()
