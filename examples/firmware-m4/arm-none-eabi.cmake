set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_C_FLAGS_INIT "-mcpu=cortex-m4 -mthumb")
# a program for the compiler's test would need a startup of its own
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
