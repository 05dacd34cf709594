;;; Pictures: what drawing them with Maxima's package draw takes beside draw itself.
;;;
;;; Entry points: $anmech_load_draw, $anmech_draw, $anmech_drawing_times, $anmech_make_room, $anmech_file_exists.

(in-package :anmech)
(needs "session/texts" "numerics/evaluation" "numerics/integration" "numerics/motion")

(defun draw-compiled-p ()
  "Whether draw has been compiled on this machine."
  (let ((binary (compile-file-pathname (format nil "~a/gnuplot.lisp" (maxima::maxima-objdir "share" "draw")))))
    (and (probe-file binary) t)))

(maxima::defmfun maxima::$anmech_load_draw ()
  "anmech_load_draw(): draw's functions.  Where draw is not compiled yet, what plane pictures take is loaded as source:
to compile all of draw takes a quarter of a minute on some Lisps, and they draw a motion as fast without."
  (unless (fboundp 'maxima::$draw2d)
    (let ((sources (mapcar #'maxima::$file_search '("grcommon.lisp" "gnuplot.lisp"))))
      (if (or (draw-compiled-p) (notevery #'stringp sources))
          (maxima::$load "draw")
          (let (#+sbcl (sb-ext:*evaluator-mode* :interpret)
                (*error-output* (make-broadcast-stream))
                (*load-verbose* nil))
            (mapc #'maxima::$load sources)))))
  'maxima::$done)

#+ecl
(defun call-with-plain-shell (thunk)
  "Maxima's system() on ECL waits for a command in two threads, which now and then wait for each other for ever."
  (flet ((plain (&rest parts) (ext:system (format nil "~{~a~^ ~}" parts))))
    (let* ((names (remove-if-not #'fboundp (list 'maxima::$system 'maxima::system-impl)))
           (usual (mapcar #'symbol-function names)))
      (unwind-protect
           (progn (dolist (name names) (setf (symbol-function name) #'plain))
                  (funcall thunk))
        (mapc (lambda (name function) (setf (symbol-function name) function)) names usual)))))

(maxima::defmfun maxima::$anmech_draw (draw parts)
  "anmech_draw(draw2d, [object or option, ...]): the picture, by draw."
  (flet ((picture () (maxima::mapply1 draw (rest parts) draw nil)))
    #+ecl (call-with-plain-shell #'picture)
    #-ecl (picture)))

(defun step-times (motion)
  "The times between the steps, from the first to the last at which the motion is given."
  (let* ((reached (motion-reached motion))
         (forward (>= reached (start-time motion))))
    (append (remove-if (lambda (time) (if forward (>= time reached) (<= time reached)))
                       (coerce (integration-times (motion-integration motion)) 'list))
            (list reached))))

(defun thinned (list most)
  "About MOST elements of LIST, at equal distances, and the last one."
  (let ((stride (ceiling (length list) most)))
    (append (loop for element in (butlast list)
                  for place from 0
                  when (zerop (mod place stride)) collect element)
            (last list))))

(maxima::defmfun maxima::$anmech_drawing_times (motion least most)
  "anmech_drawing_times(record, least, most): from LEAST to MOST times, about, between which a motion may be drawn
straight.  Steps are short where much happens, so each of them is divided alike."
  (let* ((times (thinned (step-times motion) most))
         (parts (ceiling least (max 1 (1- (length times))))))
    (numbers-list
     (append (loop for (start end) on times
                   while end
                   append (loop for part from 0 below parts
                                collect (+ start (* (/ part (float parts 1d0)) (- end start)))))
             (last times)))))

(maxima::defmfun maxima::$anmech_make_room (file)
  "anmech_make_room(file): its directory exists, it may be written, and it is not there."
  (handler-case (progn (ensure-directories-exist file)
                       (close (open file :direction :output :if-exists :supersede))
                       (delete-file file))
    (error () (complain "cannot write the file ~a" file)))
  'maxima::$done)

(maxima::defmfun maxima::$anmech_file_exists (file)
  "anmech_file_exists(file)"
  (and (probe-file file) t))
