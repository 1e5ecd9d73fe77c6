# Stands in for rosidl_default_generators where messages are wanted in Python alone: rosidl_default_generators_DIR points here.
#
# rclpy loads the Python classes, the C messages, and what Fast DDS needs to describe and to send those. Nothing of ours loads the C++
# messages, which are more than half of the work of a compiler. tf2_msgs has them all the same: nearly every C++ node that somebody
# builds beside the environment listens to /tf.
set(also_in_cpp tf2_msgs)

find_package(rosidl_core_generators REQUIRED)
if(NOT PROJECT_NAME IN_LIST also_in_cpp)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
endif()

# Every generated file includes the same headers: several of them in one go take a fraction of the time. Descriptions stay alone: each repeats
# those of the types that it contains, under the same names.
function(compile_several_files_in_one_go)
  set(typesupports c fastrtps_c introspection_c cpp fastrtps_cpp)
  list(TRANSFORM typesupports PREPEND rosidl_typesupport_)
  foreach(part rosidl_generator_c rosidl_generator_py ${typesupports})
    if(TARGET ${PROJECT_NAME}__${part})
      set_target_properties(${PROJECT_NAME}__${part} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 24)
    endif()
  endforeach()
  if(TARGET ${PROJECT_NAME}__rosidl_generator_c)
    get_target_property(sources ${PROJECT_NAME}__rosidl_generator_c SOURCES)
    list(FILTER sources INCLUDE REGEX "__description\\.c$")
    set_source_files_properties(${sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  endif()
endfunction()
cmake_language(DEFER CALL compile_several_files_in_one_go)

set(rosidl_default_generators_FOUND TRUE)
