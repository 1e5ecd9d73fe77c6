# Stands in for rosidl_default_generators where messages are wanted in Python alone: rosidl_default_generators_DIR points here.
#
# rclpy loads the Python classes, the C messages and what Fast DDS needs to send those. Nothing loads the C++ messages, which are
# more than half of the work of a compiler.
find_package(rosidl_core_generators REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")

# Every generated file includes the same headers: several of them in one go take a fraction of the time.
function(compile_several_files_in_one_go)
  foreach(part rosidl_generator_py rosidl_typesupport_c rosidl_typesupport_fastrtps_c)
    set_target_properties(${PROJECT_NAME}__${part} PROPERTIES UNITY_BUILD ON)
  endforeach()
endfunction()
cmake_language(DEFER CALL compile_several_files_in_one_go)

set(rosidl_default_generators_FOUND TRUE)
