;;;; simd.lisp: what rtest_simd.mac asks.
;;;;
;;;;   with_compiler("name", expr)   the value of expr where this is the compiler of C
;;;;   lost_of(expr)                 how many of the motions of expr have not come to their ends in lanes
;;;;   files_left()                  of such calls, in the folder for passing files
;;;;   interrupted_in_run(k, expr)   the value of expr, interrupted before a program is run the kth time
;;;;   programs()                    the folder of the programs

(in-package :anmech)

(mapc #'load-kernel '("numerics/compiled_c" "numerics/motions_in_lanes"))

(maxima::defmspec maxima::$with_compiler (form)
  (let ((*c-compiler* (maxima::meval (second form))))
    (maxima::meval (third form))))

(maxima::defmspec maxima::$lost_of (form)
  (let ((lost 0) (run #'run-compiled))
    (unwind-protect
         (progn (setf (symbol-function 'run-compiled)
                      (lambda (&rest arguments)
                        (let ((motions (apply run arguments)))
                          (incf lost (count nil motions))
                          motions)))
                (maxima::meval (second form))
                lost)
      (setf (symbol-function 'run-compiled) run))))

(maxima::defmfun maxima::$files_left ()
  (maxima-list (mapcar #'namestring (directory (format nil "~a/anmech.part-*" maxima::$maxima_tempdir)))))

(maxima::defmfun maxima::$programs () (coerce (folder-of-programs) 'simple-string))

(maxima::defmspec maxima::$interrupted_in_run (form)
  (let ((run #'run-c))
    (unwind-protect
         (progn (setf (symbol-function 'run-c) (interrupting-at (second form) run))
                (maxima::meval (third form)))
      (setf (symbol-function 'run-c) run))))
