"""Runs independent units of work in processes of this machine or on a Ray cluster. User documentation: ``docs/many_machines.md``.

A ``Unit`` is a function by name with JSON arguments and a folder of its own. ``run_units`` runs many units on a backend: ``LocalWorkers``
(``local.py``) or ``RayCluster`` (``ray_cluster.py``). The content of a result depends neither on the backend nor on the order.

    # the module my_work, which the workers can import
    def square(arguments, folder, context):
        write_file(folder / "square.txt", str(arguments["x"] ** 2))  # gibson_sim.writing
        context.progress("written")
        return {"square": arguments["x"] ** 2}

    units = [Unit(f"{k:04d}", "my_work:square", {"x": k}) for k in range(100)]
    results = run_units(units, LocalWorkers(2), output=Path("out"), on_result=lambda result: print(result.id, result.error or result.value))
    # out/0007/square.txt exists; results are in the order of the units

Imports neither ROS nor Ray; only ``ray_cluster.py`` imports Ray, when a cluster is used.
"""
