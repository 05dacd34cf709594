;;; anmech: what Maxima's integrate loads.
;;;
;;; At its first need integrate loads a file of Maxima's, facexp, which defines half a hundred functions under plain
;;; names, for good.  So it is loaded here, once, and what it changed is taken back; while integrate works for a verb it
;;; is there.
;;;
;;; Entry points: anmech_integrate; CALL-WITH-LIBRARY.

(in-package :anmech)
(needs "session/attempt")

(defvar *library-changes* :unknown "What loading it changed: lists of a symbol and its state with it.")

(defparameter *lists-of-definitions*
  '(maxima::$functions maxima::$macros maxima::$values maxima::$props maxima::$rules maxima::$aliases
    maxima::$dependencies maxima::$gradefs maxima::$myoptions)
  "Where Maxima lists what was defined.")

(defun copied-properties (properties)
  "PROPERTIES, copied as far as Maxima changes them in place: what put has said stands in a list inside a list.  The
rest is not looked into, for facts may be circular."
  (loop for (name value) on properties by #'cddr
        collect name
        collect (case name
                  ((maxima::mprops maxima::$props) (cons (first value) (copied-properties (rest value))))
                  (t value))))

(defun same-properties-p (a b)
  (and (= (length a) (length b))
       (loop for (name value) on a by #'cddr
             for (other-name other) on b by #'cddr
             always (and (eq name other-name)
                         (case name
                           ((maxima::mprops maxima::$props) (same-properties-p (rest value) (rest other)))
                           (t (eql value other)))))))

(defun state-of (symbol)
  "Its properties, and a list of its value if it has one."
  (list (symbol-plist symbol) (and (boundp symbol) (list (symbol-value symbol)))))

(defun set-state (symbol state)
  (setf (symbol-plist symbol) (first state))
  (if (second state) (set symbol (first (second state))) (makunbound symbol)))

(defun user-states ()
  "Copies of the states of all symbols that a user can type, but for the lists of these."
  (let ((table (make-hash-table :test #'eq)))
    (do-symbols (symbol :maxima table)
      (when (and (find (char (concatenate 'string (symbol-name symbol) " ") 0) "$%")
                 (not (constantp symbol))
                 (not (member symbol *lists-of-definitions*)))
        (destructuring-bind (properties value) (state-of symbol)
          (setf (gethash symbol table) (list (copied-properties properties) value)))))))

(defun same-state-p (a b)
  (and (same-properties-p (first a) (first b))
       (eq (null (second a)) (null (second b)))
       (eql (first (second a)) (first (second b)))))

(defun call-keeping-lists (thunk)
  (let ((lists (mapcar (lambda (name) (copy-list (symbol-value name))) *lists-of-definitions*)))
    (unwind-protect (funcall thunk)
      (mapc #'set *lists-of-definitions* lists))))

(defun load-library ()
  "Its functions declare some variables when they are first called."
  (let ((*standard-output* (make-broadcast-stream)))
    (maxima::meval '((maxima::$anmech_attempt) ((maxima::$load) "facexp")))
    (dolist (function '(maxima::$facsum maxima::$factorfacsum))
      (maxima::meval `((maxima::$anmech_attempt) ((,function) ((maxima::mplus) maxima::$x 1) maxima::$x))))))

(defun library-changes ()
  "Load the library, and take back what that changed: lists of a symbol and its state with the library."
  (let ((before (user-states)) (changes '()))
    (call-keeping-lists #'load-library)
    (maphash (lambda (symbol after)
               (let ((then (gethash symbol before '(() ()))))
                 (unless (same-state-p then after)
                   (push (list symbol after) changes)
                   (set-state symbol then))))
             (user-states))
    changes))

(defun call-with-library (thunk)
  "THUNK while the library is there."
  (when (eq *library-changes* :unknown) (setq *library-changes* (library-changes)))
  (let ((states (loop for (symbol) in *library-changes* collect (cons symbol (state-of symbol)))))
    (unwind-protect
         (progn (loop for (symbol state) in *library-changes* do (set-state symbol state))
                (call-keeping-lists thunk))
      (loop for (symbol . state) in states do (set-state symbol state)))))

(maxima::defmfun maxima::$anmech_integrate (form variable)
  "anmech_integrate(expr, x): integrate(expr, x), which leaves none of what it loads."
  (call-with-library (lambda () (maxima::mfuncall 'maxima::$integrate form variable))))
