# provided_below(<variable>): sets <variable> to the prefix of the ROS installation, or of the workspace, under this one
# that already has the package of the current project, else to "".
#
# Where there is one, the package here must not hide it: it installs no messages, no entry in the ament index, no environment.
# What remains are the empty local_setup files that colcon sources for every ament_cmake package.
function(provided_below variable)
  set(${variable} "" PARENT_SCOPE)
  get_filename_component(own_prefix "${CMAKE_INSTALL_PREFIX}" REALPATH)
  string(REPLACE ":" ";" prefixes "$ENV{AMENT_PREFIX_PATH}")
  foreach(prefix IN LISTS prefixes)
    get_filename_component(real_prefix "${prefix}" REALPATH)
    # Our own earlier build, whose setup file was sourced, does not count.
    if(real_prefix STREQUAL own_prefix OR NOT EXISTS "${prefix}/share/ament_index/resource_index/packages/${PROJECT_NAME}")
      continue()
    endif()
    set(${variable} "${prefix}" PARENT_SCOPE)
    message(STATUS "${PROJECT_NAME}: ${prefix} has it; nothing is built")
    # What colcon passes to every package is used here, or CMake warns.
    foreach(option AMENT_CMAKE_SYMLINK_INSTALL AMENT_TEST_RESULTS_DIR BUILD_TESTING Python3_EXECUTABLE)
      set(ignored "${${option}}")
    endforeach()
    foreach(extension sh bash zsh dsv)
      file(WRITE "${CMAKE_CURRENT_BINARY_DIR}/empty/local_setup.${extension}" "")
    endforeach()
    install(DIRECTORY "${CMAKE_CURRENT_BINARY_DIR}/empty/" DESTINATION "share/${PROJECT_NAME}")
    return()
  endforeach()
endfunction()
