"""What the user writes, and how it becomes a Scene.

The data's way::

    scene.toml -> tables, with --set                  load
    + data sheet, calibration of a real camera        data_sheet, calibrated, calibration_file
    -> validated tables, text as SI                   document (border, optics_tables, sensor_tables, source_tables,
                                                      material_tables); faults says what is wrong with them
    + beam tables, IES, R_A, BRDF, prints             beside, intensity_files, material_files, ring_calibration
    -> frozen values                                  convert (poses, sensor_values, source_convert, material_convert)
    -> numbers for spectra                            spectral
    -> Scene, its wide sources cut, checked           load

`named_files` says on which files the result depends.
"""
