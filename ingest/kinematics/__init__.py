"""Data compatibility: do attitude, gyro, accelerometer, velocity and position agree as one rigid body's?"""
